"""Pacing of what is written: one write at a time, and none while the one before still occupies the line."""

from firmware_link.protocol.line_rate import occupied_ns


class Line:
    """When the line is free, by the sizes of what was written and by the bit rate.

    A frame that waits in the queue of a driver would be sent however old it becomes, so a write is held back until
    the line has carried the one before: the latest command still wins.
    """

    def __init__(self, bit_rate_hz: int) -> None:
        self.free_ns = 0  # host time from which the line is free
        self._bit_rate_hz = bit_rate_hz
        self._occupied_by_size_ns: dict[int, int] = {}

    def occupied_ns(self, size: int) -> int:
        """Duration for which a write of `size` bytes occupies the line."""
        duration_ns = self._occupied_by_size_ns.get(size)
        if duration_ns is None:
            duration_ns = self._occupied_by_size_ns[size] = occupied_ns(self._bit_rate_hz, size)
        return duration_ns
