"""Explanation of a click, as a page or as JSON: what each finger feels, and softer levels.

The click is solved for the positions of the fingers. Beside it stands the row that the table has for their places,
since that is what a run plays: evaluated under the same fingers, on the same plants.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from base.arrays import Array
from base.plain import to_plain
from engine.device import Device
from engine.table import ClickEntry, Table
from engine.table.clicks import LevelSpread, played_at
from engine.touch import Placement
from precompute.clicks import ClickOptions
from tactable.explain import words
from tactable.explain.click_source import SAID, ClickSource, Summation

_PERCENTILES = {"5 %": "low_db", "50 %": "middle_db", "95 %": "high_db"}


@dataclass(frozen=True, eq=False)
class Tabulated:
    """The table's click of the nearest places, as it is played, and its levels under the fingers as in Explained."""

    click: ClickEntry
    finger_db: Array


@dataclass(frozen=True, eq=False)
class Explained:
    """A click as it is played, and at softer levels.

    finger_db (finger, 4): level under each finger, nominal, then 5th, 50th and 95th percentile over fresh plants, by
    the peak, or as `summation` says.
    tabulated: None where the table has no click for these fingers.
    """

    click: ClickEntry
    softer: tuple[ClickEntry, ...]
    finger_db: Array
    tabulated: Tabulated | None
    options: ClickOptions
    summation: Summation

    @property
    def placement(self) -> Placement:
        """The fingers."""
        return self.click.placement


def explain_click(source: ClickSource, placement: Placement, level_db: float) -> Explained:
    """Explain the click of a placement at a level. Raises TableError where no finger is felt."""
    strongest, own = source.solve(placement), source.table.click_at(placement, level_db)
    click = played_at(strongest, level_db)
    levels_db = [below_db for below_db in source.table.device.levels_db if below_db < click.level_db]
    return Explained(
        click=click,
        softer=tuple(played_at(strongest, below_db) for below_db in levels_db),
        finger_db=_levels_under(source, placement, click),
        tabulated=None if own is None else Tabulated(own, _levels_under(source, placement, own)),
        options=source.options,
        summation=source.summation,
    )


def _levels_under(source: ClickSource, placement: Placement, click: ClickEntry) -> Array:
    """Levels (finger, 4) as Explained has them."""
    peak_db = source.levels_of_click(click, placement)
    return np.column_stack([peak_db[0], *np.percentile(peak_db[1:], (5, 50, 95), axis=0)])


_BORDER = "30 ms is the border of one pulse and vibration (docs/theory.md, Time and clicks)"
_OWN = (
    *("wanted_level_db", "achieved", "amplitude", "length_s", "sample_rate_hz", "level_db", "peak_s"),
    *("residual_from_s", "residual_db"),
)


def click_json(table: Table, explained: Explained) -> dict[str, Any]:
    """Return the click as plain values for JSON; an infinite level is written as null."""
    click, device = explained.click, table.device
    zones = words.zone_lists(device, explained.placement)
    return to_plain(
        {
            "device": device.name,
            "fingerprint": table.fingerprint,
            "fingers": words.fingers_json(device, explained.placement, explained.finger_db.tolist()),
            "felt_zones": zones["felt"],
            "quiet_zones": zones["quiet"],
            **{key: getattr(click, key) for key in _OWN},
            "waveform": click.waveform.T,
            "threshold": device.threshold.title,
            "temporal_summation": explained.summation.value,
            "felt_db": _spread_json(click.felt),
            "quiet_db": _spread_json(click.quiet),
            "exceeds_s": click.exceeds_at_s(),
            "table": explained.tabulated and _tabulated_json(table, explained.placement, explained.tabulated),
            "softer": [
                {
                    "level_db": softer.level_db,
                    "amplitude": softer.amplitude,
                    "quiet_db": _spread_json(softer.quiet),
                    "exceeds_s": softer.exceeds_at_s(),
                }
                for softer in explained.softer
            ],
            "options": explained.options,
            "spread": device.spread,
            "estimated": [*device.estimated_values, "detection threshold", "spreads of the sampled plants"],
        }
    )


def _tabulated_json(table: Table, placement: Placement, tabulated: Tabulated) -> dict[str, Any]:
    click = tabulated.click
    return {
        "places_m": click.placement.position_m,
        "tolerance_m": click.tolerance_m,
        "achieved": click.achieved,
        "amplitude": click.amplitude,
        "felt_db": _spread_json(click.felt),
        "quiet_db": _spread_json(click.quiet),
        "fingers": words.fingers_json(table.device, placement, tabulated.finger_db.tolist()),
    }


def print_click(out: Console, table: Table, explained: Explained) -> None:
    """Print the click, its prediction over the sampled plants, the table's, and softer levels."""
    click, options, device = explained.click, explained.options, table.device
    head = f"{device.name}, {words.placement_text(device, explained.placement)}: a click of {1e3 * click.length_s:g} ms"
    wanted = (
        f"{words.level_text(click.wanted_level_db)} wanted"
        if math.isfinite(click.wanted_level_db)
        else "as strong as it is"
    )
    words.print_lines(out, f"{head}, solved for these positions, {wanted}")
    words.print_lines(out, *_prediction_lines(explained, device.threshold.above))
    out.print(_finger_grid(table, explained))
    words.print_lines(out, f"{SAID[explained.summation]}; {_BORDER}", _table_words(table, explained))
    if explained.softer:
        out.print(_softer_grid(explained.softer))
    words.print_lines(out, f"made with: {_option_words(options, device)}")
    words.print_estimates(out, device, device.threshold)


def _prediction_lines(explained: Explained, above: str) -> list[str]:
    click = explained.click
    loud = f"weakest felt finger {click.level_db:z.1f} dB {above} in 95 % of the sampled plants"
    if click.quiet is not None:
        loud += f", strongest quiet finger {click.quiet.high_db:z.1f} dB at most"
    if not click.achieved:
        loud += " - NOT ACHIEVED, the best possible"
    return [
        loud,
        f"threshold passed: {_passed_words(click)}; last peak at {1e3 * click.peak_s:.1f} ms; "
        f"from {1e3 * click.residual_from_s:g} ms felt fingers stay below {click.residual_db:z.1f} dB (nominal plant)",
        f"played at {100 * click.amplitude:.1f} % of its waveform",
    ]


def _passed_words(click: ClickEntry) -> str:
    """Time after which every felt finger has passed its threshold, in words."""
    if click.wanted_level_db < min(click.exceeds_s):
        return f"not known below {min(click.exceeds_s):g} dB"
    passed_s = click.exceeds_at_s()
    return "never by a felt finger" if passed_s is None else f"after {1e3 * passed_s:.1f} ms"


def _finger_grid(table: Table, explained: Explained) -> Grid:
    """A row for each finger; the columns of the table's click where there is one."""
    caption = f"dB {table.device.threshold.above}; percentiles over {explained.options.judged} fresh plants"
    columns, levels_db, tabulated = ["nominal", *_PERCENTILES], explained.finger_db, explained.tabulated
    if tabulated is not None:
        columns += ["table's: nominal", *_PERCENTILES]
        levels_db = np.hstack([levels_db, tabulated.finger_db])
    return words.finger_grid(table.device, explained.placement, columns, levels_db.tolist(), caption)


def _table_words(table: Table, explained: Explained) -> str:
    """Click that the table itself plays for these fingers, with its promise, in words."""
    if explained.tabulated is None:
        return "the table has no click for these fingers: a run solves the click of their places when they come"
    click = explained.tabulated.click
    places = words.placement_text(table.device, click.placement)
    promise = f"felt {click.felt.low_db:z.1f} dB (5 % of the plants are below)"
    if click.quiet is not None:
        promise += f", quiet {click.quiet.high_db:z.1f} dB (5 % are above)"
    return f"the table plays its click of {places}, for fingers within {1e3 * click.tolerance_m:.2g} mm: {promise}"


def _softer_grid(softer: Sequence[ClickEntry]) -> Grid:
    grid = Grid(
        "played softer", "amplitude", "quiet 95 % dB", "threshold passed", caption="quiet fingers get softer by as much"
    )
    for each in softer:
        quiet = "" if each.quiet is None else f"{each.quiet.high_db:z.1f}"
        grid.add_row(f"felt {each.level_db:g} dB", f"{100 * each.amplitude:.1f} %", quiet, _passed_words(each))
    return grid


def _option_words(options: ClickOptions, device: Device) -> str:
    """Options of clicks in words: limits, plants and what is not known of them."""
    within_m = device.spread.reach_m if options.tolerance_m is None else options.tolerance_m
    return (
        f"{1e3 * options.length_s:g} ms, quiet fingers at {options.quiet_db:g} dB at most in 95 % of the plants, "
        f"tones {1 / options.crowding:g}/length apart; solved with {options.pool} plants, evaluated on "
        f"{options.judged} others (seed {options.seed}), each finger within {1e3 * within_m:g} mm; made for the spread "
        f"{device.spread_text}"
    )


def _spread_json(spread: LevelSpread | None) -> dict[str, float] | None:
    """Levels in dB by name: nominal, and percentiles over the sampled plants."""
    if spread is None:
        return None
    return {"nominal": spread.nominal_db, **{name: getattr(spread, key) for name, key in _PERCENTILES.items()}}
