"""The table file: clicks, modes, best rows and sweeps, read, written and compared."""

from engine.table.clicks import ClickEntry, Clicks
from engine.table.schema import TableError
from engine.table.table import Table

__all__ = ["ClickEntry", "Clicks", "Table", "TableError"]
