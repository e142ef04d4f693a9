"""Figures of merit of a table, and of its drives played unchanged on another bar."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.steady import Modes, SteadyDrive
from engine.steady.given_drive import compute_levels
from engine.steady.steady_solver import SteadySolver
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from precompute.fleet.units import FleetError
from precompute.model.assembly import assemble
from precompute.sampling.steady_modes import steady_basis, steady_modes
from precompute.studies.two_fingers import finger_pairs

_FELT, _QUIET = 0, 1


@dataclass(frozen=True)
class _Played:
    """A drive for one felt and one quiet finger, and their levels in dB (case, finger), standard fingers first."""

    drive: SteadyDrive
    position_m: tuple[complex, complex]
    level_db: Array

    @property
    def contrast_db(self) -> float:
        """Felt over quiet power, each averaged over the sampled fingers."""
        power = (10 ** (self.level_db[1:] / 10)).mean(axis=0)
        return float(10 * np.log10(power[_FELT] / power[_QUIET]))

    def on(self, device: Device, modes: Modes) -> "_Played":
        """The drive on another bar."""
        drive = self.drive
        levels = compute_levels(
            device, modes, self.position_m, drive.frequencies_hz, np.asarray(drive.complex_amplitudes)
        )
        return _Played(drive, self.position_m, levels)


def compute_table_figures(table: Table) -> dict[str, float | None]:
    """Figures by name with units; None where a bar has no such figure.

    Contrasts are those of the drives that a run solves at 20 dB for one felt and one quiet finger in mid-zone.
    """
    solver, middles_m = SteadySolver(table.device, table.modes), _middles_m(table.device)
    contrast_db = [played.contrast_db for played in _usual_drives(table)]
    loudest = [solver.solve([at_m], [True], math.inf) for at_m in middles_m]
    return {
        "worst_expected_contrast_db": min(contrast_db, default=None),
        "median_expected_contrast_db": statistics.median(contrast_db) if contrast_db else None,
        "least_full_level_db": min(drive.weakest_felt_db for drive in loudest),
        "rows_out_of_reach": sum(not row.achieved for rows in table.best_rows.values() for row in rows),
        "clicks": len(table.clicks),
        "click_pitch_mm": 1e3 * table.places.pitch_m if table.clicks else None,
        "weakest_click_db": min(table.clicks.felt_low_db.tolist(), default=None),
    }


def evaluate_table(table: Table, device: Device) -> dict[str, float | None]:
    """Contrasts of the same drives on another `device`, and the loss of contrast and level there, by name.

    Raises FleetError for a bar with other zones or actuators.
    """
    for part in ("zones", "actuators"):
        own, other = ([thing.name for thing in getattr(each, part)] for each in (table.device, device))
        if own != other:
            raise FleetError(f"{table.path}: is for {part} {', '.join(own)}, this bar has {', '.join(other)}")
    modes = steady_modes(steady_basis(assemble(device)))
    pairs = [(played, played.on(device, modes)) for played in _usual_drives(table)]
    contrast_db = [there.contrast_db for _, there in pairs]
    lost_db = [here.contrast_db - there.contrast_db for here, there in pairs]
    level_lost_db = [float(here.level_db[0, _FELT] - there.level_db[0, _FELT]) for here, there in pairs]
    return {
        "worst_expected_contrast_db": min(contrast_db, default=None),
        "median_expected_contrast_db": statistics.median(contrast_db) if contrast_db else None,
        "median_contrast_lost_db": statistics.median(lost_db) if lost_db else None,
        "greatest_contrast_lost_db": max(lost_db, default=None),
        "greatest_level_lost_db": max(level_lost_db, default=None),
        "greatest_level_gained_db": -min(level_lost_db) if level_lost_db else None,
    }


def _usual_drives(table: Table) -> list[_Played]:
    """The drives of every two zones, one felt and one quiet, with what the table's own bar makes of them."""
    device, modes = table.device, table.modes
    solver, middles_m, found = SteadySolver(device, modes), _middles_m(device), list[_Played]()
    for felt, quiet in finger_pairs(device):
        position_m = middles_m[felt], middles_m[quiet]
        drive = solver.solve(position_m, [True, False], DEFAULT_LEVEL_DB)
        found.append(_Played(drive, position_m, np.zeros((1, 2))).on(device, modes))
    return found


def _middles_m(device: Device) -> Sequence[complex]:
    return [zone.middle_m for zone in device.zones]
