"""What is wrong with a table."""


class TableError(Exception):
    """A table that cannot be used: missing, truncated, corrupted, foreign, newer or stale; the message says which."""
