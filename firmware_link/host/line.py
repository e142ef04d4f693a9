"""The line to the device: what numbers its frames, when it is free for the next write, and what is sent repeatedly."""

from firmware_link.protocol.framing import FrameEncoder, occupied_ns
from firmware_link.protocol.layout import Message


class Line:
    """When the line is free, by the sizes of what was written and by the bit rate, and what numbers its frames.

    A frame that waits in the queue of a driver would be sent however old it becomes, so a write is held back until
    the line has carried the one before: the latest command still wins.
    """

    def __init__(self, bit_rate_hz: int, encoder: FrameEncoder) -> None:
        self.encoder = encoder
        self.free_ns = 0  # host time from which the line is free
        self._bit_rate_hz = bit_rate_hz
        self._occupied_by_size_ns: dict[int, int] = {}

    def occupied_ns(self, size: int) -> int:
        """Duration for which a write of `size` bytes occupies the line."""
        duration_ns = self._occupied_by_size_ns.get(size)
        if duration_ns is None:
            duration_ns = self._occupied_by_size_ns[size] = occupied_ns(self._bit_rate_hz, size)
        return duration_ns


class RepeatedRequest:
    """A request that is sent again each period, until its answer ends the state that asks for it.

    This says when the next copy is due; its owner says which request its state asks for.
    """

    def __init__(self, line: Line, due_ns: int) -> None:
        self.due_ns = due_ns  # the next copy is due at this time
        self._line = line

    def next_frame(self, request: Message, period_ns: int, now_ns: int, before: bytes = b"") -> bytes:
        """Frame of a copy due behind the bytes `before`, else empty. The period begins once the line has carried it."""
        if now_ns < self.due_ns:
            return b""
        frame = before + self._line.encoder.encode(request)
        self.due_ns = now_ns + period_ns + self._line.occupied_ns(len(frame))
        return frame
