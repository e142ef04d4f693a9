"""Explanation of the steady drive for fingers at positions: solved now, with what each finger feels."""

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from base.plain import to_plain
from engine.device import Device, Threshold
from engine.steady.steady_drive import CASES, compute_levels
from engine.table import Table
from engine.table.best_rows import BestRow
from engine.touch import Placement
from precompute.builder.measured_responses import plant_of
from precompute.predict.at_positions import SAMPLES, PlacementFigures, SteadyDesigner
from tactable.explain import words


def designer_of(table: Table, device: Device | None = None) -> SteadyDesigner:
    """Solves drives as a run of this table does, from its modes, and computes their figures.

    `device`: the table's with another threshold curve, which modes do not depend on.
    """
    plant, modes = plant_of(table), table.modes
    if device is not None:
        threshold_m_per_s2 = device.threshold.peak_m_per_s2(modes.frequency_hz)
        plant = replace(plant, device=device)  # type: ignore[type-var]  # every plant is a dataclass
        modes = replace(modes, threshold_m_per_s2=threshold_m_per_s2)
    return SteadyDesigner(plant.device, plant, modes)


def placed_drive_json(table: Table, figures: PlacementFigures, threshold: Threshold) -> dict[str, Any]:
    """Return the drive as plain values for JSON: levels in dB above `threshold`, an infinite one as null."""
    drive, device, spread = figures.drive, table.device, figures.spread
    placement = Placement(figures.positions_m, drive.felt)
    spreads = {"felt_db": spread.felt, "quiet_db": spread.quiet, "contrast_spread_db": spread.contrast}
    return to_plain(
        {
            "device": device.name,
            "fingerprint": table.fingerprint,
            "wanted_level_db": drive.wanted_level_db,
            "achieved": drive.achieved,
            "objective": drive.objective,
            "drive": words.drive_json(drive),
            "fingers": words.fingers_json(device, placement, _levels_of(figures)),
            "level_db": drive.weakest_felt_db,
            "contrast_db": figures.contrast_db,
            "expected_contrast_db": figures.expected_contrast_db,
            "t90_s": figures.t90_s,
            **{
                name: levels and dict(zip(words.PERCENTILES, astuple(levels), strict=True))
                for name, levels in spreads.items()
            },
            "sampled_cases": SAMPLES,
            "threshold": threshold.title,
            "estimated": [*device.estimated_values, "detection threshold"],
        }
    )


def print_placed_drive(out: Console, table: Table, figures: PlacementFigures, threshold: Threshold) -> None:
    """Print the drive, and what each finger feels: standard fingers and percentiles over sampled ones."""
    drive, device = figures.drive, table.device
    placement = Placement(figures.positions_m, drive.felt)
    head = f"{device.name}, {words.placement_text(device, placement)}: {words.level_text(drive.wanted_level_db)} wanted"
    reached = f"weakest felt finger {drive.weakest_felt_db:z.1f} dB {threshold.above}"
    if figures.contrast_db is not None and figures.expected_contrast_db is not None:
        expected = f"expected {figures.expected_contrast_db:z.1f} dB over {SAMPLES} sampled {sampled_word(device)}"
        reached += f", contrast {figures.contrast_db:z.1f} dB, {expected}"
    if not drive.achieved:
        reached += " - NOT ACHIEVED, the loudest drive"
    words.print_lines(
        out, f"{head}, solved for these positions, as a run does", *words.drive_lines(device, drive), reached
    )
    words.print_lines(out, f"t90 {1e3 * figures.t90_s:.0f} ms; maximised: {drive.objective}; no bound is computed")
    out.print(_finger_grid(replace(device, threshold=threshold), placement, _levels_of(figures), SAMPLES))
    words.print_estimates(out, device, threshold)


def _levels_of(figures: PlacementFigures) -> list[list[float]]:
    """Levels (finger, 4): of a standard finger, then percentiles over the sampled ones."""
    levels_db = enumerate(figures.level_db.tolist())
    return [[level_db, *astuple(figures.finger_percentiles(finger))] for finger, level_db in levels_db]


def _finger_grid(device: Device, placement: Placement, levels_db: Sequence[Sequence[float]], cases: int) -> Grid:
    """Levels (finger, 4): of a standard finger, then percentiles over `cases` sampled ones."""
    caption = (
        f"dB {device.threshold.above}; percentiles over {cases} sampled {sampled_word(device)}, fingers of "
        f"{device.finger.spread:g}-fold spread, each within {1e3 * device.spread.reach_m:g} mm of its position; "
        f"spread {device.spread.name or 'of the device file'}"
    )
    return words.finger_grid(device, placement, ("standard", *words.PERCENTILES), levels_db, caption)


def sampled_word(device: Device) -> str:
    """What the figures of a steady drive are over."""
    is_of_bars = device.spread.is_of_bars or device.uncertainty is not None
    return "surfaces and fingers" if is_of_bars else "fingers"


class ExplainedRow:
    """The row of a table for fingers. Raises TableError for none.

    levels_db (finger, 4): of a standard finger, then 5th, 50th and 95th percentile over the sampled cases.
    """

    def __init__(self, table: Table, placement: Placement, level_db: float) -> None:
        device = table.device
        self.table, self.placement = table, placement
        self.felt_zones = words.zone_names(device, placement)
        self.row: BestRow = table.best_row(self.felt_zones, level_db)
        played = (self.row.frequencies_hz, self.row.complex_amplitudes)
        standard_db, *sampled_db = compute_levels(device, table.modes, placement.position_m, *played)
        percentiles_db = np.percentile(sampled_db, (5, 50, 95), axis=0)
        self.levels_db: list[list[float]] = np.column_stack([standard_db, *percentiles_db]).tolist()


def best_row_json(explained: ExplainedRow) -> dict[str, Any]:
    """The row as plain values for JSON, which has no infinite level: None stands for it."""
    table, row, placement = explained.table, explained.row, explained.placement
    device, names = table.device, [zone.name for zone in table.device.zones]
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
            "fingers": words.fingers_json(device, placement, explained.levels_db),
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
    out.print(_finger_grid(device, placement, explained.levels_db, CASES))
    words.print_estimates(out, device, device.threshold)
