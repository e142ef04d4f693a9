"""Stream of the device's accelerometer, on the host: asked for, checked against the line, renewed while it is wanted.

The device streams for one lease after each SENSE. The first SENSE has a lease of 0: its answer says how fast the
accelerometer is, and only a line that carries that gets a stream. A stream that is not renewed ends, as a drive does.
"""

from firmware_link.host.line import Line, RepeatedRequest
from firmware_link.host.link_values import AccelerometerDescribed
from firmware_link.host.outbox import NS_PER_MS
from firmware_link.protocol.framing import sensed_rate_hz
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import ACCELEROMETER, Accelerometer, Features, Sense

LEASE_MS = 500  # a board whose host is gone streams on for at most this long
RENEWAL_NS = LEASE_MS * NS_PER_MS // 3  # two renewals in a row may be lost
MHZ_PER_HZ = 1_000


class Sensing:
    """The stream of one session; `start` begins it, and a new session has none until then."""

    def __init__(self, line: Line) -> None:
        self.is_wanted = False
        self._is_described = False
        self._request = RepeatedRequest(line, 0)

    def start(self, features: Features, now_ns: int) -> None:
        """Ask for the stream from now on. Raises LinkError for a device without an accelerometer."""
        if ACCELEROMETER not in features:
            raise LinkError("the board has no accelerometer: choose another sensor, or a firmware that reads one")
        self.is_wanted, self._is_described = True, False
        self._request.due_ns = now_ns

    def end(self) -> None:
        """Renew the stream no longer."""
        self.is_wanted = False

    @property
    def due_ns(self) -> int | None:
        """When `next_frame` has one, perhaps in the past; None while no stream is wanted."""
        return self._request.due_ns if self.is_wanted else None

    def next_frame(self, now_ns: int) -> bytes:
        """The next SENSE, where it is due; empty otherwise."""
        if not self.is_wanted:
            return b""
        return self._request.next_frame(Sense(LEASE_MS if self._is_described else 0), RENEWAL_NS, now_ns)

    def described(
        self, message: Accelerometer, bit_rate_hz: int, number_of_actuators: int, now_ns: int
    ) -> AccelerometerDescribed:
        """Take the answer to a SENSE. Raises LinkError where the line does not carry the samples."""
        rate_hz = message.rate_mhz / MHZ_PER_HZ
        carried_hz = sensed_rate_hz(bit_rate_hz, number_of_actuators)
        if rate_hz > carried_hz:
            self.end()
            raise LinkError(
                f"the accelerometer takes {rate_hz:g} samples a second and a line of {bit_rate_hz} bit/s "
                f"carries {carried_hz:.0f} of them with {number_of_actuators} actuators: open the port with a higher "
                "--bit-rate, where board and line have one (USB has none of its own; give 1000000)"
            )
        if not self._is_described:
            self._is_described = True
            self._request.due_ns = now_ns
        return AccelerometerDescribed(rate_hz, message.scale_nm_per_s2 * 1e-9, message.greatest, message.lost)
