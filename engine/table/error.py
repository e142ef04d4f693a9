"""What is wrong with a table."""

from firmware_link.protocol.errors import TactableError


class TableError(TactableError):
    """A table that cannot be used: missing, truncated, corrupted, foreign, newer or stale; the message says which."""
