"""Explanation of the steady drive for fingers at positions: solved now, with what each finger feels."""

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from base.plain import to_plain
from engine.device import Device, Threshold
from engine.table import Table
from engine.touch import Placement
from precompute.builder.measured_responses import plant_of
from precompute.predict.at_positions import SAMPLES, PlacementFigures, SteadyDesigner
from tactable.explain import words

PERCENTILES = ("5 %", "50 %", "95 %")


def designer_of(table: Table, device: Device | None = None) -> SteadyDesigner:
    """Solves drives as a run of this table does, from its modes, and computes their figures.

    `device`: the table's with another threshold curve, which modes do not depend on.
    """
    plant, modes = plant_of(table), table.modes
    if device is not None:
        threshold_m_per_s2 = device.threshold.peak_m_per_s2(modes.frequency_hz)
        plant, modes = plant.with_device(device), replace(modes, threshold_m_per_s2=threshold_m_per_s2)
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
            "fingers": [
                {**finger, "level_db": {"nominal": level_db, **_by_percentile(figures.finger_percentiles(number))}}
                for number, (finger, level_db) in enumerate(
                    zip(words.placement_json(device, placement), figures.level_db.tolist(), strict=True)
                )
            ],
            "level_db": drive.weakest_felt_db,
            "contrast_db": figures.contrast_db,
            "expected_contrast_db": figures.expected_contrast_db,
            "t90_s": figures.t90_s,
            **{name: levels and _by_percentile(levels) for name, levels in spreads.items()},
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
    spreads = [astuple(figures.finger_percentiles(finger)) for finger in range(len(drive.felt))]
    out.print(finger_grid(replace(device, threshold=threshold), placement, figures.level_db.tolist(), spreads, SAMPLES))
    words.print_estimates(out, device, threshold)


def finger_grid(
    device: Device, placement: Placement, standard_db: Sequence[float], spreads: Sequence[Sequence[float]], cases: int
) -> Grid:
    """Levels of each finger: a standard one, and percentiles over `cases` sampled ones."""
    caption = (
        f"dB {device.threshold.above}; percentiles over {cases} sampled {sampled_word(device)}, fingers of "
        f"{device.finger.spread:g}-fold spread, each within {1e3 * device.spread.reach_m:g} mm of its position; "
        f"spread {device.spread.name or 'of the device file'}"
    )
    grid = Grid("finger", "role", "standard", *PERCENTILES, caption=caption)
    figures = zip(words.finger_names(device, placement), placement.is_felt, standard_db, spreads, strict=True)
    for name, is_felt, level_db, spread in figures:
        shown = [f"{value:z.1f}" for value in (level_db, *spread)]
        grid.add_row(name, "felt" if is_felt else "quiet", *shown)
    return grid


def sampled_word(device: Device) -> str:
    """What the figures of a steady drive are over."""
    is_of_bars = device.spread.is_of_bars or device.uncertainty is not None
    return "surfaces and fingers" if is_of_bars else "fingers"


def _by_percentile(levels: Any) -> dict[str, float]:
    return dict(zip(PERCENTILES, astuple(levels), strict=True))
