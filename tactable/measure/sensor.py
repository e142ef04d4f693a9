"""Sensors behind one small interface: blocks of samples with a declared rate, channels and units.

A converter has its own clock, and between a sample and its arrival lies a latency that differs from one start to the
next. Both are unknown. So a sensor that can, records the drive of an actuator beside the acceleration, by a *loopback*
channel: both pass through the same converter, and their ratio has neither clock nor latency in it. Without loopback
the magnitude of a response is known and its phase is not.
"""

from dataclasses import dataclass
from typing import Protocol

from base.arrays import Array
from base.errors import TactableError

ACCELERATION = "acceleration"
LOOPBACK = "loopback "
FORCE, REFERENCE = "force", "reference"
UNITS = {ACCELERATION: "m/s^2", FORCE: "N", REFERENCE: "m/s^2"}
"""Units by channel; a loopback has none."""


class SensorError(TactableError, ValueError):
    """A sensor or a stream of samples cannot be used; the message names it, the place and the remedy."""


@dataclass(frozen=True)
class SensorForm:
    """Form of the samples of a sensor: rate, channels and their ends.

    channels: "acceleration" in m/s^2, and "loopback NAME" in fractions of full scale for an actuator NAME whose drive
    is recorded; of taps "force" in N, and "reference" in m/s^2, of an accelerometer that stays in place. clips_at
    (channel,): the greatest value that each can have, infinite where that is not known.
    """

    sample_rate_hz: float
    channels: tuple[str, ...]
    clips_at: tuple[float, ...]
    is_simulated: bool = False

    @property
    def acceleration(self) -> int:
        """Index of the channel of the acceleration."""
        return self.channels.index(ACCELERATION)

    def loopback(self, actuator: str) -> int | None:
        """Index of the channel that records the drive of an actuator; None where none does."""
        name = LOOPBACK + actuator
        return self.channels.index(name) if name in self.channels else None


@dataclass(frozen=True)
class Block:
    """Samples (sample, channel) in the units of the form, in the order in which they were taken.

    NaN is a sample that the source knows to be lost. arrived_ns: host time after they were read.
    """

    values: Array
    arrived_ns: int


class Sensor(Protocol):
    """A running converter. `close` ends it."""

    @property
    def form(self) -> SensorForm:
        """Form of the samples."""

    def fileno(self) -> int:
        """The descriptor, to poll."""

    def read(self) -> Block | None:
        """New samples since the last call, or None. Raises SensorError at the end of the stream."""

    def pace(self) -> float:
        """The pace of its clock over the board's, less 1, where it knows it already; 0 where not."""

    def close(self) -> None:
        """End it."""
