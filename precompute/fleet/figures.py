"""Figures of merit of a table."""

import math
import statistics
from collections.abc import Iterator

import numpy as np

from engine.steady.given_drive import compute_levels
from engine.steady.steady_solver import SteadySolver
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from precompute.studies.two_fingers import finger_pairs


def compute_table_figures(table: Table) -> dict[str, float | None]:
    """Figures by name with units; None where a bar has no such figure."""
    solver = SteadySolver(table.device, table.modes)
    contrast_db = list(_contrasts(table, solver))
    loudest = [solver.solve([zone.middle_m], [True], math.inf) for zone in table.device.zones]
    return {
        "worst_expected_contrast_db": min(contrast_db, default=None),
        "median_expected_contrast_db": statistics.median(contrast_db) if contrast_db else None,
        "least_full_level_db": min(drive.weakest_felt_db for drive in loudest),
        "rows_out_of_reach": sum(not row.achieved for rows in table.best_rows.values() for row in rows),
        "clicks": len(table.clicks),
        "click_pitch_mm": 1e3 * table.places.pitch_m if table.clicks else None,
        "weakest_click_db": min(table.clicks.felt_low_db.tolist(), default=None),
    }


def _contrasts(table: Table, solver: SteadySolver) -> Iterator[float]:
    """Felt over quiet power in dB, each averaged over sampled fingers, of every felt and quiet finger in mid-zone.

    Of the drives that a run solves at 20 dB.
    """
    device = table.device
    for felt, quiet in finger_pairs(device):
        position_m = device.zones[felt].middle_m, device.zones[quiet].middle_m
        drive = solver.solve(position_m, [True, False], DEFAULT_LEVEL_DB)
        amplitude = np.asarray(drive.complex_amplitudes)
        _, *sampled_db = compute_levels(device, table.modes, position_m, drive.frequencies_hz, amplitude)
        of_felt, of_quiet = (10 ** (np.array(sampled_db) / 10)).mean(axis=0)
        yield float(10 * np.log10(of_felt / of_quiet))
