"""Explanation of a click, as a page or as JSON: prediction, bound, softer levels, and the clicks that lost."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from engine.device import Spread
from engine.plain import to_plain
from engine.table import ClickEntry, Table
from engine.table.click import LevelSpread, played_at
from engine.touch import ZoneState
from precompute.clicks import ClickOptions
from precompute.clicks.evaluation import Levels
from precompute.model.threshold import THRESHOLD_NAME
from tactable.explain.click_course import played_displacement
from tactable.explain.click_rivals import Rival, solve_rivals
from tactable.explain.click_source import ClickSource
from tactable.explain.words import level_text, state_text, zone_names

_PERCENTILES = {"5 %": "low_db", "50 %": "middle_db", "95 %": "high_db"}


@dataclass(frozen=True, eq=False)
class Explained:
    """A click as it is played, at full strength and at softer levels, with the alternatives that lost."""

    click: ClickEntry
    strongest: ClickEntry
    softer: tuple[ClickEntry, ...]
    is_tabulated: bool
    options: ClickOptions
    rivals: tuple[Rival, ...]


def explain_click(source: ClickSource, states: tuple[ZoneState, ...], level_db: float, *, rivals: bool) -> Explained:
    """Explain the click of a state at a level; rivals take seconds. Raises TableError where no finger is felt."""
    strongest = source.solve_click(states)
    click = played_at(strongest, level_db)
    levels_db = [below_db for below_db in source.table.device.levels_db if below_db < click.level_db]
    return Explained(
        click=click,
        strongest=strongest,
        softer=tuple(played_at(strongest, below_db) for below_db in levels_db),
        is_tabulated=source.holds(states),
        options=source.options,
        rivals=tuple(solve_rivals(source, strongest)) if rivals else (),
    )


_OWN = (
    *("wanted_level_db", "achieved", "amplitude", "length_s", "sample_rate_hz", "level_db", "peak_s", "objective"),
    *("residual_from_s", "residual_db"),
)


def click_json(table: Table, explained: Explained) -> dict[str, Any]:
    """The click as plain values for JSON; infinite levels are None."""
    click, device = explained.click, table.device
    values: dict[str, Any] = to_plain(
        {
            "device": device.name,
            "fingerprint": table.fingerprint,
            "state": click.index,
            "felt_zones": zone_names(device, click.states, ZoneState.FELT),
            "quiet_zones": zone_names(device, click.states, ZoneState.QUIET),
            "is_tabulated": explained.is_tabulated,
            **{key: getattr(click, key) for key in _OWN},
            "waveform": played_displacement(click).T,
            "threshold": THRESHOLD_NAME,
            "felt_db": spread_json(click.felt),
            "quiet_db": spread_json(click.quiet),
            "zones": [
                {
                    "name": zone.name,
                    "state": state.name.lower(),
                    "acceleration_at_finger_m_per_s2": predicted and predicted.acceleration_at_finger_m_per_s2,
                    "level_db": predicted and predicted.level_db,
                }
                for zone, state, predicted in zip(device.zones, click.states, click.zones, strict=True)
            ],
            "exceeds_s": click.exceeds_at_s(),
            "upper_bound_db": click.bound_db,
            "optimality_gap_db": click.gap_db,
            "softer": [
                {
                    "level_db": softer.level_db,
                    "amplitude": softer.amplitude,
                    "quiet_db": spread_json(softer.quiet),
                    "exceeds_s": softer.exceeds_at_s(),
                }
                for softer in explained.softer
            ],
            "options": explained.options,
            "alternatives": [_rival_json(rival) for rival in explained.rivals],
            "estimated": [*device.inferred, "detection threshold", "spreads of the sampled plants"],
        }
    )
    return values


def print_click(out: Console, table: Table, explained: Explained) -> None:
    """Print the click, its prediction over the sampled plants, softer levels, and the alternatives."""
    click, options, device = explained.click, explained.options, table.device
    where = "" if explained.is_tabulated else " - NOT IN THE TABLE, solved now by its options"
    head = f"{device.name}, {state_text(device, click.states)}: a click of {1e3 * click.length_s:g} ms"
    out.print(f"{head}, {_wanted_words(click)}{where}", markup=False, highlight=False, soft_wrap=True)
    for line in _prediction_lines(explained):
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    out.print(_spread_grid(click, options.judged))
    out.print(_zone_grid(table, click))
    if explained.softer:
        out.print(_softer_grid(explained.softer))
    if explained.rivals:
        out.print(_rival_grid(explained))
    out.print(f"made with: {option_words(options, device.spread)}", markup=False, highlight=False, soft_wrap=True)
    estimates = ", ".join([*device.inferred, THRESHOLD_NAME])
    out.print(f"ESTIMATES: {estimates}", style="dim", markup=False, highlight=False, soft_wrap=True)


def _wanted_words(click: ClickEntry) -> str:
    if click.wanted_level_db == float("inf"):
        return "as strong as it is"
    return f"{level_text(click.wanted_level_db)} wanted"


def _prediction_lines(explained: Explained) -> list[str]:
    click = explained.click
    loud = f"weakest felt finger {click.level_db:z.1f} dB above threshold in 95 % of the sampled plants"
    if click.quiet is not None:
        loud += f", strongest quiet finger {click.quiet.high_db:z.1f} dB at most"
    if not click.achieved:
        loud += " - NOT ACHIEVED, the best possible"
    bound = "no bound is known"
    if math.isfinite(click.bound_db):
        bound = f"upper bound for its tones {click.bound_db:z.2f} dB (gap {click.gap_db:.2f} dB)"
    return [
        loud,
        f"threshold passed: {_passed_words(click)}; last peak at {1e3 * click.peak_s:.1f} ms; "
        f"from {1e3 * click.residual_from_s:g} ms felt fingers stay below {click.residual_db:z.1f} dB (nominal plant)",
        f"maximised: {click.objective}; in the mean of the plants it is optimised over, {bound}",
        f"played at {100 * click.amplitude:.1f} % of its waveform",
    ]


def _passed_words(click: ClickEntry) -> str:
    """Time after which every felt finger has passed its threshold, in words."""
    if click.wanted_level_db < min(click.exceeds_s):
        return f"not known below {min(click.exceeds_s):g} dB"
    passed_s = click.exceeds_at_s()
    return "never by a felt finger" if passed_s is None else f"after {1e3 * passed_s:.1f} ms"


def _spread_grid(click: ClickEntry, evaluated: int) -> Grid:
    grid = Grid("dB above threshold", "nominal", *_PERCENTILES, caption=f"percentiles over {evaluated} sampled plants")
    sides = {"weakest felt finger": click.felt, "strongest quiet finger": click.quiet}
    for name, spread in sides.items():
        if spread is not None:
            shown = (spread.nominal_db, spread.low_db, spread.middle_db, spread.high_db)
            grid.add_row(name, *(f"{value:z.1f}" for value in shown))
    return grid


def _zone_grid(table: Table, click: ClickEntry) -> Grid:
    grid = Grid("zone", "state", "peak m/s²", "level dB", caption="nominal plant")
    for zone, state, predicted in zip(table.device.zones, click.states, click.zones, strict=True):
        shown = ("", "")
        if predicted is not None:
            shown = f"{predicted.acceleration_at_finger_m_per_s2:.2f}", f"{predicted.level_db:z.1f}"
        grid.add_row(zone.name, state.name.lower(), *shown)
    return grid


def _softer_grid(softer: Sequence[ClickEntry]) -> Grid:
    grid = Grid(
        "played softer",
        "amplitude",
        "quiet 95 % dB",
        "threshold passed",
        caption="quiet fingers get softer by as much",
    )
    for each in softer:
        quiet = "" if each.quiet is None else f"{each.quiet.high_db:z.1f}"
        grid.add_row(f"felt {each.level_db:g} dB", f"{100 * each.amplitude:.1f} %", quiet, _passed_words(each))
    return grid


def _rival_grid(explained: Explained) -> Grid:
    caption = "dB above threshold, as loud as limits and quiet level allow, on the same plants"
    grid = Grid("alternative", "felt 5 %", "50 %", "quiet 95 %", "passed", "lost: ", caption=caption)
    own = explained.strongest
    grid.add_row("this click", *_rival_figures(own.felt, own.quiet, own.exceeds_at_s()), "")
    for rival in explained.rivals:
        evaluation = rival.click.evaluation
        grid.add_row(
            rival.name, *_rival_figures(evaluation.felt, evaluation.quiet, evaluation.exceeds_s), rival.lost_by
        )
    return grid


def _rival_figures(
    felt: LevelSpread | Levels, quiet: LevelSpread | Levels | None, passed_s: float | None
) -> tuple[str, ...]:
    return (
        f"{felt.low_db:z.1f}",
        f"{felt.middle_db:z.1f}",
        "" if quiet is None else f"{quiet.high_db:z.1f}",
        "never" if passed_s is None else f"{1e3 * passed_s:.1f} ms",
    )


def option_words(options: ClickOptions, spread: Spread) -> str:
    """What clicks were made with, in words: limits, plants and their spreads."""
    lengths = ", ".join(f"{1e3 * length_s:g}" for length_s in options.lengths_s)
    wanted = "as strong as can be" if options.wanted_db is None else f"no stronger than {options.wanted_db:g} dB"
    brake = "no brake" if options.brake_s is None else f"braked by {1e3 * options.brake_s:g} ms"
    slew = "no slew limit" if options.slew_per_s is None else f"slew up to {options.slew_per_s:g} full scales a second"
    within_m = spread.finger_position_m if options.tolerance_m is None else options.tolerance_m
    return (
        f"{lengths} ms, {wanted}, quiet fingers at {options.quiet_db:g} dB at most in 95 % of the plants, {brake}, "
        f"{slew}, tones {1 / options.crowding:g}/length apart; optimised over {options.scenarios} plants, "
        f"trimmed on {options.trimmed}, evaluated on {options.judged} others (seed {options.seed}); standard "
        f"deviations of stiffness {100 * spread.stiffness:g} % and mass {100 * spread.mass:g} %, finger within "
        f"{100 * spread.finger:g} % and {1e3 * within_m:g} mm"
    )


def spread_json(spread: LevelSpread | Levels | None) -> dict[str, float] | None:
    """Levels in dB by name: nominal, and percentiles over the sampled plants."""
    if spread is None:
        return None
    return {"nominal": spread.nominal_db, **{name: getattr(spread, key) for name, key in _PERCENTILES.items()}}


def _rival_json(rival: Rival) -> dict[str, Any]:
    evaluation = rival.click.evaluation
    return {
        "name": rival.name,
        "lost_by": rival.lost_by,
        "felt_db": spread_json(evaluation.felt),
        "quiet_db": spread_json(evaluation.quiet),
        "exceeds_s": evaluation.exceeds_s,
        "residual_db": evaluation.residual_db,
    }
