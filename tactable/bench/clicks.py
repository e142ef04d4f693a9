"""Clicks of every state of one felt and one quiet finger beside gated steady drives, on the same fresh plants."""

import itertools
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from engine.device import Device
from engine.plain import to_plain
from engine.table import Entry
from engine.touch import Placement, ZoneState
from precompute.clicks import Click, ClickOptions, ClickSolver
from precompute.clicks.baselines import gate
from precompute.entries.alternatives import paper_drive
from precompute.entries.prediction import States
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from precompute.parallel.pool import solve_in_processes
from precompute.studies.anywhere import AIM_FELT_DB, AIM_QUIET_DB

_WAYS = {"click": "click", "gated": "steady drive gated", "paper": "paper's objective gated"}
_ENDS = (("felt_db", "low_db"), ("quiet_db", "high_db"))


def run_clicks_bench(
    device: Device, options: ClickOptions, workers: int, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Felt and quiet levels of every ordered pair of zones, three ways, each as loud as limits and quiet level allow.

    The steady drive is the entry of the level at which it is felt most when gated. SIMULATED. `on_progress` is told the
    fraction done.
    """
    zones = len(device.zones)
    # Both orders of a pair have the same fingers, and are solved by one process.
    chunks = [[pair, pair[::-1]] for pair in itertools.combinations(range(zones), 2)]
    rows, start_s = dict[tuple[int, int], dict[str, Any]](), time.perf_counter()
    for pair, row in solve_in_processes(partial(_begin, device, options), chunks, workers):
        rows[pair] = row
        on_progress(len(rows) / (zones * (zones - 1)))
    ordered = [rows[pair] for pair in sorted(rows)]
    return {
        "simulated": True,
        "device": device.name,
        "estimates": [*device.estimated_values, device.threshold.title],
        "threshold": device.threshold.title,
        "options": to_plain(options),
        "spread": to_plain(device.spread),
        "workers": workers,
        "time_s": time.perf_counter() - start_s,
        "pairs": ordered,
        "summary": {way: _summary([row[way] for row in ordered]) for way in _WAYS},
    }


def _begin(
    device: Device, options: ClickOptions
) -> Callable[[tuple[int, int]], tuple[tuple[int, int], dict[str, Any]]]:
    clicks, entries = ClickSolver(device, options), EntrySolver(assemble(device))
    return lambda pair: (pair, _compare(clicks, entries, pair))


def _compare(clicks: ClickSolver, entries: EntrySolver, pair: tuple[int, int]) -> dict[str, Any]:
    device = clicks.device
    felt, quiet = pair
    states: States = tuple(
        ZoneState.FELT if zone == felt else ZoneState.QUIET if zone == quiet else ZoneState.FREE
        for zone in range(len(device.zones))
    )
    steady = {
        "gated": entries.solve(states),
        "paper": [entries.evaluate(states, np.inf, paper_drive(entries, states), "paper")],
    }
    placement = Placement.in_zones(device, states)
    judged = {way: _best_gated(clicks, placement, drives, _WAYS[way]) for way, drives in steady.items()}
    click = clicks.solve(placement)
    figures = {"click": _figures(click) | {"gap_db": click.gap_db}, **{way: _figures(it) for way, it in judged.items()}}
    return {"felt": device.zones[felt].name, "quiet": device.zones[quiet].name, **figures}


def _best_gated(clicks: ClickSolver, placement: Placement, entries: Sequence[Entry], name: str) -> Click:
    """Of the entries of all levels the one that is felt most when it is gated."""
    length_s, slew_per_s = clicks.options.lengths_s[0], clicks.device.limits.slew_per_s
    judged = [clicks.evaluate(placement, length_s, gate(entry, length_s, slew_per_s), name) for entry in entries]
    return max(judged, key=lambda click: click.evaluation.felt.low_db)


def _figures(click: Click) -> dict[str, Any]:
    evaluation = click.evaluation
    assert evaluation.quiet is not None  # there is a quiet finger in every pair
    return {
        "felt_db": to_plain(evaluation.felt),
        "quiet_db": to_plain(evaluation.quiet),
        "exceeds_s": evaluation.exceeds_s,
    }


def _summary(figures: list[dict[str, Any]]) -> dict[str, Any]:
    felt_db = [each["felt_db"]["low_db"] for each in figures]
    quiet_db = [each["quiet_db"]["high_db"] for each in figures]
    reached = [f >= AIM_FELT_DB and q <= AIM_QUIET_DB for f, q in zip(felt_db, quiet_db, strict=True)]
    return {
        "least_felt_db": min(felt_db),
        "mean_felt_db": float(np.mean(felt_db)),
        "greatest_quiet_db": max(quiet_db),
        "reach_the_aim": sum(reached),
    }


def print_clicks_bench(out: Console, result: dict[str, Any]) -> None:
    """The pairs as a table: what 95 % of the plants exceed under the felt finger, and keep to under the quiet one."""
    options, spread = result["options"], result["spread"]
    grid = Grid(
        "felt",
        "quiet",
        *[f"{name}: {kind}" for name in _WAYS.values() for kind in ("felt dB", "quiet dB")],
        title=f"{result['device']}, clicks of {1e3 * options['lengths_s'][0]:g} ms, SIMULATED",
    )
    for row in result["pairs"]:
        levels = [f"{row[way][kind][end]:z.1f}" for way in _WAYS for kind, end in _ENDS]
        grid.add_row(row["felt"], row["quiet"], *levels)
    out.print(grid)
    for way, name in _WAYS.items():
        figures = result["summary"][way]
        out.print(
            f"{name}: felt {figures['least_felt_db']:.1f} dB at least, {figures['mean_felt_db']:.1f} on average; quiet "
            f"{figures['greatest_quiet_db']:.1f} dB at most; {figures['reach_the_aim']} of {len(result['pairs'])} with "
            f"felt {AIM_FELT_DB:g} and quiet {AIM_QUIET_DB:g}",
            highlight=False,
        )
    out.print(
        f"dB above the {result['threshold']}; 5 % felt and 95 % quiet of {options['judged']} fresh plants; "
        f"optimised over {options['scenarios']}, trimmed on {options['trimmed']} (seed {options['seed']}); stiffness "
        f"{100 * spread['stiffness']:g} %, mass {100 * spread['mass']:g} %, finger {100 * spread['finger']:g} %, "
        f"{1e3 * spread['finger_position_m']:g} mm; {result['time_s']:.0f} s by {result['workers']} processes",
        highlight=False,
    )
    out.print(f"ESTIMATES: {', '.join(result['estimates'])}", style="dim")
