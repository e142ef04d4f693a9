"""The error of tables, which names what is wrong and where."""

from base.errors import TactableError


class TableError(TactableError):
    """A table that cannot be used: missing, truncated, corrupted, foreign, newer or stale; the message says which."""
