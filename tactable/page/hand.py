"""A drive that a person asks for on the page: frequency, amplitude and phase of each actuator."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from base.errors import TactableError
from engine.device import Device

FIRST_HZ, FIRST_AMPLITUDE = 150.0, 0.2
_MOST_DEGREES = 360.0
_ROUNDING = 1e-9
Channels = tuple[tuple[float, float, float], ...]


class HandError(TactableError, ValueError):
    """A drive that is none, or that is beyond a limit; the message names actuator, value and limit."""


@dataclass(frozen=True)
class HandDrive:
    """A drive by hand: for each actuator frequency in Hz, amplitude as a fraction of full scale, phase in degrees."""

    channels: Channels

    @property
    def frequencies_hz(self) -> Sequence[float]:
        """Frequency of each actuator."""
        return [hz for hz, _, _ in self.channels]

    @property
    def amplitudes(self) -> Sequence[float]:
        """Fractions of full scale."""
        return [amplitude for _, amplitude, _ in self.channels]

    @property
    def phases_rad(self) -> Sequence[float]:
        """Phase of each actuator."""
        return [math.radians(degrees) for _, _, degrees in self.channels]


def first_channels(device: Device) -> Channels:
    """What sounds before a slider has moved: all actuators together, at a fifth of the limit."""
    amplitude = FIRST_AMPLITUDE * device.limits.amplitude
    low_high = (actuator.band_hz for actuator in device.actuators)
    return tuple((min(max(FIRST_HZ, low_hz), high_hz), amplitude, 0.0) for low_hz, high_hz in low_high)


def read_channels(value: Any, device: Device) -> Channels:
    """The drive of a browser's list of [Hz, fraction of full scale, degrees]. Raises HandError."""
    names = [actuator.name for actuator in device.actuators]
    is_shaped = isinstance(value, list) and len(value) == len(names)
    if not is_shaped or not all(isinstance(each, list) and len(each) == 3 for each in value):
        raise HandError(f"hand: expected [Hz, fraction of full scale, degrees] for each of {', '.join(names)}")
    limit, channels = device.limits.amplitude, []
    for actuator, each in zip(device.actuators, value, strict=True):
        if not all(isinstance(part, int | float) and math.isfinite(part) for part in each):
            raise HandError(f"hand: actuator {actuator.name}: {each!r}: expected three numbers")
        hz, amplitude, degrees = each
        low_hz, high_hz = actuator.band_hz
        if not low_hz <= hz <= high_hz:
            raise HandError(f"hand: actuator {actuator.name}: {hz:g} Hz; expected {low_hz:g} to {high_hz:g} Hz")
        if not 0 <= amplitude <= limit * (1 + _ROUNDING):
            raise HandError(
                f"hand: actuator {actuator.name}: {100 * amplitude:g} %; expected 0 to {100 * limit:g} % of full scale"
            )
        if abs(degrees) > _MOST_DEGREES:
            raise HandError(f"hand: actuator {actuator.name}: {degrees:g} degrees; expected -360 to 360")
        channels.append((float(hz), float(amplitude), float(degrees)))
    return tuple(channels)
