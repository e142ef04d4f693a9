"""A steady drive: one frequency, an amplitude and a phase for each actuator, and what the fingers feel of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex

LEVEL_TOLERANCE_DB = 1e-3  # the same as in engine.table.levels; this package needs no table
_LEAST_POWER = 1e-30  # -300 dB: silence has a logarithm


@dataclass(frozen=True)
class SteadyDrive:
    """One frequency for all actuators, amplitudes (fraction of full scale) and phases, and what the fingers feel.

    level_db (finger,): under the standard fingers; sampled_level_db (case, finger): under the sampled ones.
    """

    frequency_hz: float
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    felt: tuple[bool, ...]
    wanted_level_db: float
    level_db: Array
    sampled_level_db: Array
    objective: str  # "contrast", "localized factor", or "level" where the loudest drive was asked for or is the nearest
    value: float  # what was maximised: expected contrast or level in dB, or a share
    achieved: bool  # whether the weakest felt standard finger is at the wanted level; an infinite one is always reached

    @classmethod
    def at_level(
        cls,
        wanted_db: float,
        limit: float,
        frequency_hz: float,
        amplitude: Complex,
        power: Array,
        felt: Sequence[bool],
        objective: str,
        value: float,
    ) -> "SteadyDrive":
        """A drive that was found, played softer where it is louder than the wanted level.

        amplitude (actuator,): complex, the strongest at 1, which is played at `limit` at most. power (case, finger): of
        that amplitude, over threshold, the standard case first. value: a share, or a ratio of powers.
        """
        full_db = 10 * np.log10(power[0, list(felt)].min() * limit**2)
        scale = limit * 10 ** (min(0.0, wanted_db - full_db) / 20)
        sensed_db = 10 * np.log10(np.maximum(power, _LEAST_POWER)) + 20 * np.log10(scale)
        if objective != "localized factor":
            value = float(10 * np.log10(value)) + (20 * float(np.log10(limit)) if objective == "level" else 0.0)
        return cls(
            frequency_hz=frequency_hz,
            amplitudes=tuple(np.minimum(abs(amplitude) * scale, limit).tolist()),
            phases_rad=tuple(np.angle(amplitude).tolist()),
            felt=tuple(felt),
            wanted_level_db=wanted_db,
            level_db=sensed_db[0],
            sampled_level_db=sensed_db[1:],
            objective=objective,
            value=value,
            achieved=bool(np.isinf(wanted_db) or full_db >= wanted_db - LEVEL_TOLERANCE_DB),
        )

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Frequency of each actuator: the same one."""
        return (self.frequency_hz,) * len(self.amplitudes)

    @property
    def complex_amplitudes(self) -> Complex:
        """Complex amplitudes (actuator,), fractions of full scale."""
        return np.array(self.amplitudes) * np.exp(1j * np.array(self.phases_rad))

    @property
    def weakest_felt_db(self) -> float:
        """Level of the weakest felt standard finger."""
        return float(self.level_db[list(self.felt)].min())

    @property
    def expected_contrast_db(self) -> float | None:
        """Weakest felt over strongest quiet power, averaged over the sampled cases; None: nothing is quiet.

        The cases are the few that the solver maximises over; `tactable explain` evaluates a drive over others.
        """
        if all(self.felt):
            return None
        expected, felt = (10 ** (self.sampled_level_db / 10)).mean(axis=0), np.array(self.felt)
        return float(10 * np.log10(expected[felt].min() / expected[~felt].max()))
