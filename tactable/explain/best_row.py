"""Explanation of the row of the sweep that zones play: the tabulated figures, and what fingers get of it."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from base.arrays import Array
from base.plain import to_plain
from engine.steady.given_drive import CASES, compute_levels
from engine.table import Table
from engine.table.best_rows import BestRow
from engine.touch import Placement
from tactable.explain import words
from tactable.explain.placed_drive import PERCENTILES, finger_grid


class ExplainedRow:
    """The row of a table for fingers, and their levels (case, finger), standard first. Raises TableError for none."""

    def __init__(self, table: Table, placement: Placement, level_db: float) -> None:
        device = table.device
        self.table, self.placement = table, placement
        self.felt_zones = words.zone_names(device, placement)
        self.row: BestRow = table.best_row(self.felt_zones, level_db)
        played = (self.row.frequencies_hz, self.row.complex_amplitudes)
        self.level_db: Array = compute_levels(device, table.modes, placement.position_m, *played)
        self.percentiles_db: list[list[float]] = np.percentile(self.level_db[1:], (5, 50, 95), axis=0).T.tolist()
        """5th, 50th and 95th percentile over the sampled cases of each finger."""


def best_row_json(explained: ExplainedRow) -> dict[str, Any]:
    """The row as plain values for JSON, which has no infinite level: None stands for it."""
    table, row, placement = explained.table, explained.row, explained.placement
    device, names = table.device, [zone.name for zone in table.device.zones]
    fingers = zip(
        words.placement_json(device, placement), explained.level_db[0].tolist(), explained.percentiles_db, strict=True
    )
    return to_plain(
        {
            "device": device.name,
            "fingerprint": table.fingerprint,
            "drives": "zones",
            "felt_zones": explained.felt_zones,
            "wanted_level_db": row.wanted_level_db,
            "achieved": row.achieved,
            "row": {"group": row.group, "index": row.index},
            "limited_by": row.limited_by,
            "drive": words.drive_json(row),
            "localized_factor": row.localized_factor,
            "level_db": row.level_db,
            "zones": {
                name: {"share": share, "peak_acceleration_m_per_s2": peak, "dead_spot_m_per_s2": dead}
                for name, share, peak, dead in zip(
                    names, row.shares, row.peaks_m_per_s2, row.dead_spots_m_per_s2, strict=True
                )
            },
            "fingers": [
                {**finger, "level_db": {"nominal": level_db, **dict(zip(PERCENTILES, spread, strict=True))}}
                for finger, level_db, spread in fingers
            ],
            "sampled_cases": CASES,
            "threshold": device.threshold.title,
            "estimated": [*device.estimated_values, "detection threshold"],
        }
    )


def print_best_row(out: Console, explained: ExplainedRow) -> None:
    """Print the row, its figures by zone, and what each finger gets of it."""
    row, placement, device = explained.row, explained.placement, explained.table.device
    wanted = f"{words.level_text(row.wanted_level_db)} wanted"
    lines = [f"{device.name}, {words.placement_text(device, placement)}: {wanted}, looked up for zones, as a run does"]
    felt = ", ".join(explained.felt_zones)
    reached = f"{row.level_db:.1f} dB {device.threshold.above} at the peak of the weakest wanted zone"
    missed = "" if row.achieved else " - NOT ACHIEVED, the loudest row"
    lines += [
        *words.drive_lines(device, row),
        f"localized factor {row.localized_factor:.3f} in {felt}; {reached}{missed}",
        f"row {row.index} of {row.group}; limited by {row.limited_by}",
    ]
    words.print_lines(out, *lines)
    grid = Grid("zone", "localized factor", "peak m/s²", "dead spot m/s²", caption="tabulated without fingers")
    figures = zip(device.zones, row.shares, row.peaks_m_per_s2, row.dead_spots_m_per_s2, strict=True)
    for zone, share, peak, dead in figures:
        grid.add_row(zone.name, f"{share:.3f}", f"{peak:.2f}", f"{dead:.2f}")
    out.print(grid)
    out.print(finger_grid(device, placement, explained.level_db[0].tolist(), explained.percentiles_db, CASES))
    words.print_estimates(out, device, device.threshold)
