"""A steady drive: one frequency, an amplitude and a phase for each actuator, and what the fingers feel of it."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex


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
