"""A drive that a person or a measurement asks for: checked against the device's limits, and refused beyond them.

A table's drive is scaled down to the limits (`engine.render.limits.clamp`), since its pattern is what counts. A drive
that was asked for by its numbers is refused instead: a bar that plays something else would be measured wrongly.
"""

import cmath
from dataclasses import dataclass, replace

import numpy as np

from base.arrays import Array, Complex, Points
from engine.device import Device
from engine.render.limits import Drive, LimitError, clamp
from precompute.model.assembly import assemble

_ROUNDING = 1e-9


@dataclass(frozen=True)
class AskedDrive:
    """Frequency in Hz, amplitude as a fraction of full scale and phase by actuator; amplitude 0 is a still actuator."""

    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]

    @property
    def phasors(self) -> Complex:
        """Shape (actuator,): amplitudes with their phases, fractions of full scale."""
        pairs = zip(self.amplitudes, self.phases_rad, strict=True)
        return np.array([cmath.rect(amplitude, phase_rad) for amplitude, phase_rad in pairs])

    @property
    def frequency_hz(self) -> float:
        """The frequency of the strongest actuator."""
        return self.frequencies_hz[int(np.argmax(self.amplitudes))]

    @property
    def tones(self) -> "list[AskedDrive]":
        """Its parts of one frequency each; the actuators of other parts are still."""
        channels = list(zip(self.frequencies_hz, self.amplitudes, strict=True))
        return [
            replace(self, amplitudes=tuple(size * (own_hz == hz) for own_hz, size in channels))
            for hz in dict.fromkeys(hz for hz, size in channels if size)
        ]

    @classmethod
    def of_one(cls, device: Device, actuator: int, frequency_hz: float, amplitude: float) -> "AskedDrive":
        """One actuator (its index) alone at phase 0."""
        count = range(len(device.actuators))
        amplitudes = tuple(amplitude if i == actuator else 0.0 for i in count)
        return cls((frequency_hz,) * len(count), amplitudes, (0.0,) * len(count))


def check_drive(asked: AskedDrive, device: Device) -> Drive:
    """The drive within the device's limits; raises LimitError, which names actuator, value and limit, beyond them."""
    limit = device.limits.amplitude
    for actuator, hz, amplitude in zip(device.actuators, asked.frequencies_hz, asked.amplitudes, strict=True):
        low_hz, high_hz = actuator.band_hz
        if amplitude > 0 and not low_hz <= hz <= high_hz:
            raise LimitError(
                f"actuator {actuator.name}: {hz:g} Hz is outside its band; ask for {low_hz:g} to {high_hz:g} Hz, or "
                "widen `band` in the device file if the actuator bears it"
            )
        if not 0 <= amplitude <= limit * (1 + _ROUNDING):
            raise LimitError(
                f"actuator {actuator.name}: an amplitude of {100 * amplitude:g} % is beyond limits.amplitude of "
                f"{device.name}; ask for 0 to {100 * limit:g} % of full scale"
            )
    return clamp(asked, device)


def simulate_levels(device: Device, asked: AskedDrive, position_m: Points) -> tuple[Array, Array]:
    """Peaks (point,) in m/s^2 and levels (point,) in dB above the threshold under a held drive, at points in metres.

    The surface is untouched. Tones of one frequency add as phasors, the peaks of others as magnitudes (paper eq. (8)).
    The level is that of the summed powers over the threshold at each tone. SIMULATED.
    """
    from precompute.model.response import by_tone, solve_response  # compiled kernels, which only a simulation needs

    tones_hz, weight = by_tone(np.array(asked.frequencies_hz), asked.phasors)
    unit = solve_response(assemble(device), tones_hz).acceleration(position_m)
    size = abs(np.einsum("fa,fap->fp", weight, unit))
    power = ((size / device.threshold.peak_m_per_s2(tones_hz)[:, None]) ** 2).sum(axis=0)
    return size.sum(axis=0), 10 * np.log10(np.maximum(power, 1e-30))
