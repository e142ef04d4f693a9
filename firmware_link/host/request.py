"""A request that is sent again each period, until its answer ends the state that asks for it."""

from firmware_link.host.line import Line
from firmware_link.protocol.framing import FrameEncoder
from firmware_link.protocol.layout import Message


class RepeatedRequest:
    """When the next copy of a request is due; its owner says which request its state asks for."""

    def __init__(self, encoder: FrameEncoder, line: Line, due_ns: int) -> None:
        self.due_ns = due_ns  # the next copy is due at this time
        self._encoder, self._line = encoder, line

    def next_frame(self, request: Message, period_ns: int, now_ns: int, before: bytes = b"") -> bytes:
        """Frame of a copy due behind the bytes `before`, else empty. The period begins once the line has carried it."""
        if now_ns < self.due_ns:
            return b""
        frame = before + self._encoder.encode(request)
        self.due_ns = now_ns + period_ns + self._line.occupied_ns(len(frame))
        return frame
