"""The root of the project's errors."""


class TactableError(Exception):
    """Root of every error that a user can cause and mend; its text says what, where and the remedy."""
