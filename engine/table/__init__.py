"""The table file: clicks, modes, best rows and sweeps, read, written and compared."""

from engine.table.click_entry import ClickEntry
from engine.table.click_grid import Clicks
from engine.table.error import TableError
from engine.table.table import Table

__all__ = ["ClickEntry", "Clicks", "Table", "TableError"]
