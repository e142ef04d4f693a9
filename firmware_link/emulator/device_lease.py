"""Lease of an emulated device: which frames are fresh, until when they let a drive live, when silence disarms."""

from dataclasses import dataclass

from firmware_link.protocol.messages import CLOCK_REFERENCE_SPAN, CLOCK_REFERENCE_US

# Nothing fresh for this long: disarmed until a new handshake. Not configurable: it can't be switched off.
DISARM_US = 250_000
_HALF_SPAN = CLOCK_REFERENCE_SPAN // 2
_GREATEST_STEP = 127  # a sequence is one byte: half of its numbers are ahead


@dataclass
class Lease:
    """How long the host is believed; times in device microseconds."""

    armed_us: int = 0  # what ARM allows; how far the clocks may be apart
    drive_us: int = 0  # what the last SET asked, within that
    fresh_us: int = 0  # when the last fresh frame came
    renewed_us: int = 0  # when the drive was applied or renewed
    fresh_sequence: int = 0

    def is_fresh(self, clock_reference: int, sequence: int, now_us: int) -> bool:
        """Whether a frame is neither old nor a copy: near by the clock, and ahead of what came shortly before."""
        age = (now_us // CLOCK_REFERENCE_US - clock_reference + _HALF_SPAN) % CLOCK_REFERENCE_SPAN - _HALF_SPAN
        if abs(age) * CLOCK_REFERENCE_US > self.armed_us:
            return False
        # A frame may seem up to one lease young, so its copy can pass the clock for two leases.
        is_held = now_us <= self.fresh_us + 2 * self.armed_us
        return not is_held or 1 <= (sequence - self.fresh_sequence) % 256 <= _GREATEST_STEP

    def refresh(self, sequence: int, now_us: int) -> None:
        """A fresh frame came."""
        self.fresh_us, self.fresh_sequence = now_us, sequence

    @property
    def end_us(self) -> int:
        """Time at which a drive ends that is not renewed."""
        return self.renewed_us + self.drive_us

    @property
    def watchdog_end_us(self) -> int:
        """Time at which a device disarms that hears nothing fresh."""
        return self.fresh_us + DISARM_US
