"""Explanation of the click for fingers at positions: solved now, and evaluated on fresh plants for each finger."""

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid

from engine.plain import to_plain
from engine.table import Table
from engine.table.entry import LEVEL_TOLERANCE_DB, shifted
from engine.touch import Placement
from precompute.clicks import Click, ClickOptions, ClickSolver
from precompute.clicks.evaluation import Levels, decibels
from precompute.model.threshold import THRESHOLD_NAME
from tactable.explain.click import option_words, spread_json
from tactable.explain.click_source import read_click_options
from tactable.explain.words import finger_text, level_text

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlacedClick:
    """A click solved for a placement, played softer by `change_db` (0 or less) than it was solved.

    finger_db (finger, 4): peak level under each finger, nominal, then 5th, 50th and 95th percentile over fresh plants.
    """

    click: Click
    options: ClickOptions
    wanted_level_db: float
    change_db: float
    finger_db: Array

    @property
    def waveform(self) -> Array:
        """Base displacements (actuator, sample) as they are played, fractions of full scale."""
        played: Array = self.click.waveform * 10 ** (self.change_db / 20)
        return played

    @property
    def felt_db(self) -> Levels:
        """Level under the weakest felt finger."""
        return shifted(self.click.evaluation.felt, self.change_db)

    @property
    def is_achieved(self) -> bool:
        """Whether felt fingers reach the wanted level and quiet ones keep to theirs."""
        wanted_db = self.wanted_level_db
        return self.click.achieved and (
            not isfinite(wanted_db) or self.felt_db.low_db >= wanted_db - LEVEL_TOLERANCE_DB
        )

    @property
    def quiet_db(self) -> Levels | None:
        """Level under the strongest quiet finger; None where no finger is to be quiet."""
        quiet = self.click.evaluation.quiet
        return None if quiet is None else shifted(quiet, self.change_db)


def explain_placed_click(table: Table, placement: Placement, level_db: float, tolerance_m: float) -> PlacedClick:
    """Solve the click of a placement with the table's options, for fingers within `tolerance_m` of their positions."""
    options = replace(read_click_options(table), tolerance_m=tolerance_m)
    solver = ClickSolver(table.device, options)
    click = solver.solve(placement)
    change_db = min(0.0, level_db - click.evaluation.felt.low_db)
    fresh = solver.plants_of(placement.position_m).evaluated
    peak_db = decibels(fresh.peaks(click.waveform, range(len(placement.position_m)))) + change_db
    finger_db = np.column_stack([peak_db[0], *np.percentile(peak_db[1:], (5, 50, 95), axis=0)])
    return PlacedClick(click, options, level_db, change_db, finger_db)


def placed_click_json(table: Table, explained: PlacedClick) -> dict[str, Any]:
    """The click as plain values for JSON; an infinite level is None."""
    click, device = explained.click, table.device
    evaluation, placement = click.evaluation, click.placement
    values: dict[str, Any] = to_plain(
        {
            "device": device.name,
            "fingerprint": table.fingerprint,
            "fingers": [
                {
                    "position_m": at_m,
                    "role": "felt" if is_felt else "quiet",
                    "level_db": dict(zip(("nominal", "5 %", "50 %", "95 %"), levels, strict=True)),
                }
                for at_m, is_felt, levels in zip(
                    placement.position_m, placement.is_felt, explained.finger_db.tolist(), strict=True
                )
            ],
            "wanted_level_db": explained.wanted_level_db,
            "achieved": explained.is_achieved,
            "sample_rate_hz": click.rate_hz,
            "length_s": click.length_s,
            "waveform": explained.waveform,
            "felt_db": spread_json(explained.felt_db),
            "quiet_db": spread_json(explained.quiet_db),
            "peak_s": evaluation.peak_s,
            "residual_from_s": evaluation.residual_from_s,
            "residual_db": evaluation.residual_db + explained.change_db,
            "upper_bound_db": click.bound_db + explained.change_db,
            "optimality_gap_db": click.gap_db,
            "options": explained.options,
            "spread": device.spread,
            "threshold": THRESHOLD_NAME,
            "estimated": [*device.inferred, "detection threshold", "spreads of the sampled plants"],
        }
    )
    return values


def print_placed_click(out: Console, table: Table, explained: PlacedClick) -> None:
    """Print the click: what each finger feels over the fresh plants, and what it was made with."""
    click, device, options = explained.click, table.device, explained.options
    fingers = ", ".join(map(finger_text, click.placement.position_m, click.placement.is_felt))
    lines = [f"{device.name}, {fingers}: a click of {1e3 * click.length_s:g} ms, solved for these positions"]
    loud = f"weakest felt finger {explained.felt_db.low_db:z.1f} dB above threshold in 95 % of the sampled plants"
    if explained.quiet_db is not None:
        loud += f", strongest quiet finger {explained.quiet_db.high_db:z.1f} dB at most"
    if not explained.is_achieved:
        loud += f" - NOT ACHIEVED: {level_text(explained.wanted_level_db)} wanted, this is the strongest"
    lines.append(loud)
    lines.append(
        f"upper bound for its tones, in the mean of the plants it is optimised over: "
        f"{click.bound_db + explained.change_db:z.2f} dB (gap {click.gap_db:.2f} dB)"
    )
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    caption = f"dB above threshold; percentiles over {options.judged} fresh plants"
    grid = Grid("finger", "role", "nominal", "5 %", "50 %", "95 %", caption=caption)
    placement = click.placement
    for at_m, is_felt, levels in zip(placement.position_m, placement.is_felt, explained.finger_db, strict=True):
        shown = [f"{value:z.1f}" for value in levels.tolist()]
        grid.add_row(f"{1e3 * at_m:.1f} mm", "felt" if is_felt else "quiet", *shown)
    out.print(grid)
    out.print(f"made with: {option_words(options, device.spread)}", markup=False, highlight=False, soft_wrap=True)
    estimates = ", ".join([*device.inferred, THRESHOLD_NAME])
    out.print(f"ESTIMATES: {estimates}", style="dim", markup=False, highlight=False, soft_wrap=True)
