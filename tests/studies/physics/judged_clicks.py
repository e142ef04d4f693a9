"""Clicks as a run solves them, beside a linear program over many more plants: time, levels, and whether promises hold.

    python -m tests.studies.physics.judged_clicks reference-a --placements 100 [--json]

Both solve the same random placements of two, three and five fingers in turn, and are judged on the same fresh plants:
what is felt, what is kept quiet, what is lost, and whether the promises hold. SIMULATED.
"""

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from base.arrays import Array
from engine.device import Device
from engine.touch import Placement
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.clicks.click_basis import lines_for
from precompute.clicks.click_plants import SampledPlants
from precompute.clicks.click_responses import Responses
from precompute.clicks.click_solver import FULL_SCALE
from precompute.clicks.evaluation import decibels
from precompute.sampling.placements import Anywhere, random_placements
from precompute.sampling.plants import sample_scenarios
from tactable.cli.console import show
from tactable.shipped import find_device
from tests.precompute.clicks.judge.design import ProgramSolver
from tests.studies.options import read_options

Solved = TypeVar("Solved")

CASES = ((1, 1), (1, 2), (2, 1), (1, 4), (2, 3))
"""Numbers of felt and of quiet fingers."""
FRESH, FRESH_SEED = 2000, 7083
"""Plants to judge on, of which no click was made. A 95th percentile over 600 errs by 0.15 dB, alike at all places."""
BROKEN_DB = 0.5
"""A quiet promise that is passed by more counts as broken."""
_PERCENTS = (5, 50, 95)


def judge_clicks(device: Device, placements: int) -> dict[str, Any]:
    """Solve that many random placements of each case by both solvers."""
    options = DEFAULT_OPTIONS.waited_for
    ours, program = ClickSolver(device, options), ProgramSolver(device, options)
    fresh = SampledPlants(sample_scenarios(device, FRESH, FRESH_SEED), lines_for(device, options.length_s))
    ours.solve_entry(Placement.on(device, [device.bar.length_m / 2]))  # kernels are compiled before they are timed
    rows = []
    for felt, quiet in CASES:
        asked = Anywhere(placements, fingers=felt + quiet, feeling=felt, seed=1)
        found = [_compare(ours, program, fresh, placement) for placement in random_placements(device, asked)]
        rows.append({"felt": felt, "quiet": quiet, **_summary(np.array(found))})
    return {
        "device": device.name,
        "threshold": device.threshold.title,
        "placements": placements,
        "fresh_plants": FRESH,
        "tolerance_m": options.tolerance_m,
        "cases": rows,
    }


def _compare(
    ours: ClickSolver, program: ProgramSolver, fresh: SampledPlants, placement: Placement
) -> tuple[float, ...]:
    entry, own_s = _timed(lambda: ours.solve_entry(placement))
    design, program_s = _timed(lambda: program.solve(placement))
    fingers = fresh.scenarios.place(placement.position_m, ours.options.tolerance_m)
    responses = Responses(fresh.transfer(fingers), fresh.lines)
    own = _levels_db(responses, entry.samples.T / FULL_SCALE, placement)
    other = _levels_db(responses, design.waveform, placement)
    assert entry.quiet is not None  # every case has a quiet finger
    return own_s, program_s, *own, *other, entry.felt.low_db, entry.quiet.high_db


def _timed(solve: Callable[[], Solved]) -> tuple[Solved, float]:
    start_s = time.process_time()
    found = solve()
    return found, time.process_time() - start_s


def _levels_db(responses: Responses, waveform: Array, placement: Placement) -> tuple[float, float]:
    """What 95 % of the plants reach under the weakest felt finger, and keep to under the strongest quiet one."""
    peak = decibels(responses.peaks(waveform, range(len(placement.position_m))))[1:]
    low = np.percentile(peak[:, placement.felt].min(axis=1), 5)
    return float(low), float(np.percentile(peak[:, placement.quiet].max(axis=1), 95))


def _summary(found: Array) -> dict[str, Any]:
    """Figures over placements, from rows of `_compare`."""
    own_s, program_s, felt, quiet, program_felt, program_quiet, promised_felt, promised_quiet = found.T
    loss = program_felt - felt
    return {
        "closed_form": {
            "processor_ms": {"50 %": _ms(own_s, 50), "99 %": _ms(own_s, 99)},
            "felt_db": _percentiles(felt),
            "quiet_db": _percentiles(quiet),
        },
        "program": {
            "processor_ms": {"50 %": _ms(program_s, 50), "99 %": _ms(program_s, 99)},
            "felt_db": _percentiles(program_felt),
            "quiet_db": _percentiles(program_quiet),
        },
        "loss_db": {"50 %": float(np.median(loss)), "95 %": float(np.percentile(loss, 95))},
        "times_faster": float(np.median(program_s) / np.median(own_s)),
        "promise": {
            "felt_mean_error_db": float(np.mean(promised_felt - felt)),
            "quiet_mean_error_db": float(np.mean(promised_quiet - quiet)),
            "quiet_broken_by_half_a_db": float(np.mean(quiet - promised_quiet > BROKEN_DB)),
        },
    }


def _ms(seconds: Array, percent: float) -> float:
    return 1e3 * float(np.percentile(seconds, percent))


def _percentiles(level_db: Array) -> dict[str, float]:
    return {f"{percent} %": float(np.percentile(level_db, percent)) for percent in _PERCENTS}


def print_judged(out: Console, result: dict[str, Any]) -> None:
    """Print the figures as a page."""
    out.print(
        f"{result['device']}, SIMULATED: {result['placements']} random placements of each kind, fingers within "
        f"{1e3 * result['tolerance_m']:g} mm, {result['fresh_plants']} fresh plants; dB above {result['threshold']}",
        highlight=False,
        soft_wrap=True,
    )
    levels = "5/50/95 % of placements"
    grid = Grid(
        "felt + quiet",
        "closed form, ms (99 %)",
        "program, ms",
        f"felt: {levels}",
        "program's",
        "quiet",
        "loss (95 %)",
        "promise: felt, quiet off",
        "broken",
        caption="felt: 95 % of the plants reach it; quiet: 95 % keep to it; broken: quiet promise passed by 0.5 dB",
    )
    for row in result["cases"]:
        own, other, promise = row["closed_form"], row["program"], row["promise"]
        grid.add_row(
            f"{row['felt']} + {row['quiet']}",
            f"{own['processor_ms']['50 %']:.1f} ({own['processor_ms']['99 %']:.1f})",
            f"{other['processor_ms']['50 %']:.0f}",
            _levels_text(own["felt_db"]),
            _levels_text(other["felt_db"]),
            _levels_text(own["quiet_db"]),
            f"{row['loss_db']['50 %']:.1f} ({row['loss_db']['95 %']:.1f})",
            f"{promise['felt_mean_error_db']:+.2f}, {promise['quiet_mean_error_db']:+.2f}",
            f"{100 * promise['quiet_broken_by_half_a_db']:.0f} %",
        )
    out.print(grid)


def _levels_text(level_db: dict[str, float]) -> str:
    return " / ".join(f"{value:z.1f}" for value in level_db.values())


if __name__ == "__main__":
    asked = read_options(__doc__, device=("reference-a",), placements=20, json=False)
    show(judge_clicks(find_device(asked.device), asked.placements), asked.json, print_judged)
