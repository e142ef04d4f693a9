"""One rendered state of the demo: the table's promise, and what the simulated bar did with the firmware's drive.

The promise comes from the steady-state model, the simulation from its time-domain twin: they check each other and the
whole chain between them. Neither is a measurement.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.table import ClickEntry, Entry
from engine.touch import ZoneState
from tactable.rig.bar import Simulated, SimulatedClick

AGREEMENT = 0.02
"""The fraction by which the table's promise and the simulation may differ."""


@dataclass(frozen=True)
class StateReport:
    """One state at one level: the table's promise, what the held drive did, and what was felt in the run."""

    entry: Entry
    simulated: Simulated
    felt_m_per_s2: float
    """Greatest under the fingers that were to feel, while the state lasted."""
    quiet_m_per_s2: float
    """Greatest under the others; 0 where there were none."""

    def zones_in(self, state: ZoneState) -> list[int]:
        """Indices of the zones in a state."""
        return [i for i, zone in enumerate(self.entry.zones) if zone.state is state]

    @property
    def felt_zones(self) -> list[int]:
        """Indices of the zones that are to be felt."""
        return self.zones_in(ZoneState.FELT)

    @property
    def simulated_factor(self) -> float:
        """Localized factor of the felt zones, simulated."""
        return float(self.simulated.share[self.felt_zones].sum())

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of localized factor, peaks of felt zones and acceleration at each finger."""
        entry, simulated = self.entry, self.simulated
        pairs = [(entry.localized_factor, self.simulated_factor)]
        pairs += [(entry.zones[i].peak_acceleration_m_per_s2, simulated.peak[i]) for i in self.felt_zones]
        fingers = (zone.acceleration_at_finger_m_per_s2 for zone in entry.zones)
        pairs += [
            (promised, found)
            for promised, found in zip(fingers, simulated.at_finger, strict=True)
            if promised is not None
        ]
        return float(max(abs(found / promised - 1) for promised, found in pairs))

    def level_db(self, acceleration_m_per_s2: float) -> float | None:
        """Sensation level of an acceleration by this state's drive, its tones as strong as under a felt finger.

        None for no acceleration.
        """
        zone = self.entry.zones[self.felt_zones[0]]
        if not acceleration_m_per_s2 or not zone.acceleration_at_finger_m_per_s2 or zone.sensation_level_db is None:
            return None
        change = acceleration_m_per_s2 / zone.acceleration_at_finger_m_per_s2
        return zone.sensation_level_db + 20 * math.log10(change)


@dataclass(frozen=True)
class ClickReport:
    """One click at one level: the table's promise, what the waveform did, and what was felt in the run."""

    click: ClickEntry
    simulated: SimulatedClick
    felt_m_per_s2: float
    """Greatest under the fingers that were to feel, until something else was felt."""
    quiet_m_per_s2: float
    """Greatest under the others; 0 where there were none."""

    def zones_in(self, state: ZoneState) -> list[int]:
        """Indices of the zones in a state."""
        return [i for i, found in enumerate(self.click.states) if found is state]

    @property
    def felt_zones(self) -> list[int]:
        """Indices of the zones that are to be felt."""
        return self.zones_in(ZoneState.FELT)

    @property
    def touched_zones(self) -> list[int]:
        """Indices of the zones with a finger."""
        return [i for i, zone in enumerate(self.click.zones) if zone is not None]

    @property
    def at_finger(self) -> NDArray[np.float64]:
        """Shape (zone,): greatest acceleration under each finger, simulated, m/s^2; NaN in a zone without a finger."""
        values = np.full(len(self.click.zones), np.nan)
        values[self.touched_zones] = abs(self.simulated.acceleration).max(axis=0)
        return values

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of the acceleration at each finger."""
        pairs = zip(self.click.zones, self.at_finger.tolist(), strict=True)
        promised = ((zone.acceleration_at_finger_m_per_s2, found) for zone, found in pairs if zone is not None)
        return float(max(abs(found / wanted - 1) for wanted, found in promised))

    def level_db(self, zone: int, acceleration_m_per_s2: float) -> float | None:
        """Level of an acceleration by this click, its course as under the finger in a zone; None for none."""
        promise = self.click.zones[zone]
        if promise is None or not acceleration_m_per_s2:
            return None
        return promise.level_db + 20 * math.log10(acceleration_m_per_s2 / promise.acceleration_at_finger_m_per_s2)
