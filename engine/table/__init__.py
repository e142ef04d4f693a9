"""The table file: entries, clicks and sweeps, read, written and compared."""

from engine.table.click import ClickEntry
from engine.table.entry import Entry
from engine.table.error import TableError
from engine.table.table import Table

__all__ = ["ClickEntry", "Entry", "Table", "TableError"]
