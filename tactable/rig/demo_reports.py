"""One rendered command of the demo: what its fingers were promised, and what the simulated surface did under them.

Promises are for the positions that the fingers really have, with standard fingers on the surface as it is described.
That of a steady drive was solved from modes in frequency, that of a click comes from the waveform of its table row;
the simulation takes the bytes that the firmware got to the surface in time. So they check each other and the whole
chain between them. Neither is a measurement.
"""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from engine.steady import SteadyDrive
from engine.table import ClickEntry
from engine.table.best_rows import BestRow
from engine.touch import Placement
from tactable.rig.promises import Promise
from tactable.rig.simulated_surface import SimulatedClick, SimulatedDrive

AGREEMENT = 0.02  # the fraction by which promise and simulation may differ
STILLEST_DB = -20.0
"""Fingers that are to feel less are compared with this: the wire's steps of 0.01 Hz change such a rest by up to 3 %."""


@dataclass(frozen=True)
class _CommandReport:
    """A command and what was promised of it."""

    promise: Promise

    @property
    def placement(self) -> Placement:
        """The fingers that the command was made for."""
        return self.promise.placement

    def _difference(self, simulated_m_per_s2: Array) -> float:
        """Greatest difference, relative to the promise, or to STILLEST_DB where that is less."""
        promised_m_per_s2 = self.promise.acceleration_m_per_s2
        least_m_per_s2 = promised_m_per_s2 * 10 ** ((STILLEST_DB - self.promise.level_db) / 20)
        return float(
            (abs(simulated_m_per_s2 - promised_m_per_s2) / np.maximum(promised_m_per_s2, least_m_per_s2)).max()
        )


@dataclass(frozen=True)
class DriveReport(_CommandReport):
    """A steady drive, solved or looked up for zones: its promise, and what it did when it was held.

    promised_factor: share of kinetic energy in the zones that hold the felt fingers (felt_zones, indices).
    """

    drive: SteadyDrive | BestRow
    simulated: SimulatedDrive
    felt_zones: tuple[int, ...]
    promised_factor: float

    @property
    def frequency_text(self) -> str:
        """Its frequency, or both, such as "150 & 200 Hz"."""
        sounding = zip(self.drive.frequencies_hz, self.drive.amplitudes, strict=True)
        return f"{' & '.join(f'{hz:g}' for hz in dict.fromkeys(hz for hz, size in sounding if size))} Hz"

    @property
    def simulated_factor(self) -> float:
        """Localized factor of the felt zones, simulated."""
        return float(self.simulated.share[list(self.felt_zones)].sum())

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of the acceleration under each finger, and of the localized factor."""
        factor = abs(self.simulated_factor / self.promised_factor - 1) if self.felt_zones else 0.0
        return max(factor, self._difference(self.simulated.at_finger))


@dataclass(frozen=True)
class ClickReport(_CommandReport):
    """A click: the table's row for the nearest places, and what its waveform did under the fingers."""

    click: ClickEntry
    simulated: SimulatedClick

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of the acceleration under each finger."""
        return self._difference(self.simulated.at_finger)
