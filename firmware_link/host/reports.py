"""What the device says of itself: STATUS, FAULT and LOG as events, and the acknowledgements of faults."""

from firmware_link.host.link_values import FaultReceived, LinkCounters
from firmware_link.protocol.framing import FrameEncoder
from firmware_link.protocol.messages import Ack, Fault, Log, Result, Status

Report = Status | Fault | Log


class Reports:
    """The last STATUS of a session, and the frames that acknowledge its FAULTs: `acknowledgements`, to be sent."""

    def __init__(self, counters: LinkCounters, encoder: FrameEncoder) -> None:
        self.status: Status | None = None
        self.acknowledgements = b""
        self._counters, self._encoder = counters, encoder

    def take_report(self, message: Report, sequence: int) -> Status | FaultReceived | Log:
        """Count a report and make its event."""
        match message:
            case Status():
                self._counters.statuses += 1
                self.status = message
                return message
            case Fault():
                self._counters.faults += 1
                self.acknowledgements += self._encoder.encode(Ack(message.type_byte, sequence, Result.OK))
                return FaultReceived(message.fault, message.device_time_us)
            case Log():
                self._counters.logs += 1
                return message
