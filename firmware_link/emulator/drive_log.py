"""Log of an emulated device: the frames it received and the changes of what sounds, as values and as JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from firmware_link.protocol.basis import Samples


class Cause(StrEnum):
    """Why the drive changed."""

    SET = "set"
    PLAY = "play"
    LEASE_EXPIRED = "lease expired"
    NEW_SESSION = "new session"
    STOP = "stop"
    SILENT_HOST = "silent host"
    EMERGENCY_STOP = "emergency stop"
    HUNG_UP = "hung up"
    DRIVEN_TOO_LONG = "driven too long"


class Outcome(StrEnum):
    """Whether a received frame was acted on, and if not, why."""

    ACCEPTED = "accepted"
    STALE = "stale"
    REFUSED = "refused"


@dataclass(frozen=True)
class ChannelTarget:
    """Target of one actuator from an event on; `phase_rad` is the phase at the event's time, None where it runs on.

    `limit` bounds the sum of all that sounds on it.
    """

    frequency_hz: float
    amplitude: float
    phase_rad: float | None
    limit: float = 1.0


@dataclass(frozen=True)
class PlayedWaveform:
    """A waveform that an event starts, as the device plays it; the next event takes over from it.

    `data` are its samples (sample, actuator) as little-endian int16: a log holds many of them.
    """

    sample_rate_hz: int
    number_of_actuators: int
    data: bytes
    amplitude: float

    @classmethod
    def of(cls, sample_rate_hz: int, samples: Samples, amplitude: float) -> "PlayedWaveform":
        """The waveform of samples (sample, actuator)."""
        return cls(sample_rate_hz, samples.shape[1], samples.astype("<i2").tobytes(), amplitude)

    @property
    def samples(self) -> Samples:
        """Samples (sample, actuator); SAMPLE_FULL_SCALE is full scale, straight lines between them."""
        return np.frombuffer(self.data, "<i2").astype(np.int16).reshape(-1, self.number_of_actuators)


@dataclass(frozen=True)
class DriveEvent:
    """A change of the drive, limits applied; amplitudes are fractions of full scale, slew is full scale a second."""

    device_time_us: int
    cause: Cause
    sequence: int | None
    slew_per_s: float
    channels: tuple[ChannelTarget, ...]
    waveform: PlayedWaveform | None = None


@dataclass(frozen=True)
class ReceivedFrame:
    """A frame with a valid checksum, its arrival and its outcome; SET and PLAY are applied at that time."""

    device_time_us: int
    message: str
    sequence: int
    outcome: Outcome


def encode_events(events: Sequence[DriveEvent | ReceivedFrame]) -> list[dict[str, Any]]:
    """Events as JSON objects."""
    items = [asdict(event) for event in events]
    for item in items:
        if item.get("waveform"):
            item["waveform"]["data"] = item["waveform"]["data"].hex()
    return items


def decode_drive_event(item: Mapping[str, Any]) -> DriveEvent:
    """The event of a JSON object; raises KeyError, TypeError or ValueError for anything else."""
    waveform = item["waveform"]
    return DriveEvent(
        device_time_us=item["device_time_us"],
        cause=Cause(item["cause"]),
        sequence=item["sequence"],
        slew_per_s=item["slew_per_s"],
        channels=tuple(ChannelTarget(**channel) for channel in item["channels"]),
        waveform=None if waveform is None else PlayedWaveform(**waveform | {"data": bytes.fromhex(waveform["data"])}),
    )
