"""What is wrong with a fleet."""


class FleetError(ValueError):
    """A fleet that cannot be run as described; the message names the file, the place in it, and what would do."""
