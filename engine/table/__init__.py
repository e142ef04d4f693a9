"""The table file: clicks, receptances, best rows and sweeps, read, written and compared."""

from engine.table.click import ClickEntry
from engine.table.clicks import Clicks
from engine.table.error import TableError
from engine.table.table import Table

__all__ = ["ClickEntry", "Clicks", "Table", "TableError"]
