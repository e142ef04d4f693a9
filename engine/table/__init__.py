"""The table file: clicks, receptances, entries and sweeps, read, written and compared."""

from engine.table.click import ClickEntry
from engine.table.clicks import Clicks
from engine.table.entry import Entry
from engine.table.error import TableError
from engine.table.table import Table

__all__ = ["ClickEntry", "Clicks", "Entry", "Table", "TableError"]
