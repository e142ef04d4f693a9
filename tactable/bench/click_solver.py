"""Speed and result of the click solver beside HiGHS on state-space plants, interleaved, in processor time."""

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.plain import to_plain
from engine.touch import Placement
from precompute.clicks import ClickOptions, ClickSolver
from precompute.clicks.evaluation import decibels
from precompute.entries.solver import tabulated_states
from precompute.studies.anywhere import Anywhere, random_placements
from tactable.bench.reference_clicks import ReferenceSolver

Array = NDArray[np.float64]
_Result = TypeVar("_Result")

PROGRAMS_RATIO, PLANTS_RATIO = 15.0, 25.0
"""Aims: the reference takes at least this many times the processor time."""
TWO_FINGERS_MS, FIVE_FINGERS_MS = (40.0, 120.0), 300.0
"""Aims for a click with its plants: median and 99th percentile of two fingers, and every click of five."""
_SOLVED = ("as a table", "in a run")
"""A table's clicks are solved over all sampled plants, those that fingers wait for over fewer (ClickOptions.quick)."""
_NAMES = ("fast", "reference")


def run_solver_bench(
    devices: Sequence[Device],
    options: ClickOptions,
    states: int,
    clicks: int,
    on_progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Both solvers on `states` states of each device, then the fast one on random placements.

    Of two fingers, one felt, there are `clicks` placements, of five, two felt, a fifth of that. Each state is solved by
    one solver and at once by the other, whose order alternates, on the same sampled bars and fingers; both clicks are
    evaluated on the same fresh state-space plants. Times are of this process and one thread. SIMULATED.
    """
    with threadpool_limits(1):
        rows = [
            _compare(device, options, states, clicks, lambda done, name=device.name: on_progress(name, done))  # type: ignore[misc]  # bound by default
            for device in devices
        ]
    aims = {
        "programs_ratio": PROGRAMS_RATIO,
        "plants_ratio": PLANTS_RATIO,
        "two_fingers_median_ms": TWO_FINGERS_MS[0],
        "two_fingers_p99_ms": TWO_FINGERS_MS[1],
        "five_fingers_ms": FIVE_FINGERS_MS,
    }
    return {"simulated": True, "options": to_plain(options), "aims": aims, "devices": rows}


def _compare(
    device: Device, options: ClickOptions, states: int, clicks: int, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    placements = _spread_out(device, states)
    # First what is compiled, loaded or imported at the first call.
    ClickSolver(device, replace(options, scenarios=2, trimmed=2, judged=2)).solve(placements[0])
    fast_setup_s, fast = _timed(lambda: ClickSolver(device, options))
    reference_setup_s, reference = _timed(lambda: ReferenceSolver(device, options))
    rows, before = list[dict[str, Any]](), None
    for number, placement in enumerate(placements):
        row: dict[str, Any] = {"positions_m": placement.position_m, "is_felt": placement.is_felt}
        waveforms = dict[str, Array]()
        for name in ("fast", "reference")[:: 1 if number % 2 else -1]:
            row[name] = {"plants_s": 0.0}
            if placement.position_m != before:
                row[name]["plants_s"] = _plants_s(fast if name == "fast" else reference, placement)
            if name == "fast":
                row[name]["programs_s"], click = _timed(lambda: fast.solve(placement))  # noqa: B023  # called at once
                waveforms[name] = click.waveform
                row |= {"programs": click.effort.programs, "pivots": click.effort.pivots}
                row["fallbacks"] = click.effort.fallbacks
            else:
                solved = _timed(lambda: reference.solve(placement))  # noqa: B023  # called at once
                row[name]["programs_s"], waveforms[name] = solved
        for name, waveform in waveforms.items():
            row[name] |= _levels(reference, placement, waveform)
        before = placement.position_m
        rows.append(row)
        on_progress(0.9 * len(rows) / len(placements))
    solvers = dict(zip(_SOLVED, (fast, ClickSolver(device, options.quick)), strict=True))
    return {
        "device": device.name,
        "states": rows,
        "summary": _summary(rows, fast_setup_s, reference_setup_s),
        "two_fingers": _click_times(solvers, random_placements(device, Anywhere(clicks))),
        "five_fingers": _click_times(solvers, random_placements(device, Anywhere(max(1, clicks // 5), 5, 2))),
    }


def _spread_out(device: Device, count: int) -> list[Placement]:
    """`count` tabulated states, evenly over all of them in the order of their fingers; those of one finger are few."""
    placements = sorted(
        (Placement.in_zones(device, states) for states in tabulated_states(device)),
        key=lambda placement: (len(placement.position_m), placement),
    )
    return [placements[i] for i in np.linspace(0, len(placements) - 1, min(count, len(placements))).round().astype(int)]


def _timed(call: Callable[[], _Result]) -> tuple[float, _Result]:
    start_s = time.process_time()
    result = call()
    return time.process_time() - start_s, result


def _plants_s(solver: ClickSolver | ReferenceSolver, placement: Placement) -> float:
    solver.plants_of.cache_clear()
    return _timed(lambda: solver.plants_of(placement.position_m))[0]


def _click_times(solvers: Mapping[str, ClickSolver], placements: Sequence[Placement]) -> dict[str, dict[str, Any]]:
    """Milliseconds of processor time of whole clicks, plants included, of each solver in turn."""
    times_ms, fallbacks = {name: list[float]() for name in solvers}, dict.fromkeys(solvers, 0)
    for placement in placements:
        for name, solver in solvers.items():
            solver.plants_of.cache_clear()
            taken_s, click = _timed(lambda: solver.solve(placement))  # noqa: B023  # called at once
            times_ms[name].append(1e3 * taken_s)
            fallbacks[name] += click.effort.fallbacks
    rows = dict[str, dict[str, Any]]()
    for name, taken_ms in times_ms.items():
        median, high, greatest = np.percentile(taken_ms, [50, 99, 100]).tolist()
        rows[name] = {"clicks": len(taken_ms), "median_ms": median, "p99_ms": high, "most_ms": greatest}
        rows[name]["fallbacks"] = fallbacks[name]
    return rows


def _levels(reference: ReferenceSolver, placement: Placement, waveform: Array) -> dict[str, float | None]:
    """What 95 % of the fresh plants exceed under the weakest felt finger, and keep to under the strongest quiet one."""
    fresh = reference.plants_of(placement.position_m)[2]
    level_db = decibels(fresh.peaks(waveform, range(len(placement.position_m)))[1:])
    felt_db = float(np.percentile(level_db[:, placement.felt].min(axis=1), 5))
    quiet = level_db[:, placement.quiet]
    return {"felt_db": felt_db, "quiet_db": float(np.percentile(quiet.max(axis=1), 95)) if quiet.size else None}


def _summary(rows: Sequence[dict[str, Any]], fast_setup_s: float, reference_setup_s: float) -> dict[str, Any]:
    total_s = {
        part: {name: sum(row[name][f"{part}_s"] for row in rows) for name in ("fast", "reference")}
        for part in ("programs", "plants")
    }
    total_s["setup"] = {"fast": fast_setup_s, "reference": reference_setup_s}
    felt_db = np.array([row["fast"]["felt_db"] - row["reference"]["felt_db"] for row in rows])
    quiet_db = {name: [row[name]["quiet_db"] for row in rows if row[name]["quiet_db"] is not None] for name in _NAMES}
    return {
        "processor_s": total_s,
        "programs_ratio": total_s["programs"]["reference"] / total_s["programs"]["fast"],
        "plants_ratio": sum(total_s[part]["reference"] for part in ("plants", "setup"))
        / sum(total_s[part]["fast"] for part in ("plants", "setup")),
        "felt_difference_db": {
            "least": float(felt_db.min()),
            "mean": float(felt_db.mean()),
            "greatest": float(felt_db.max()),
        },
        "mean_felt_db": {name: float(np.mean([row[name]["felt_db"] for row in rows])) for name in _NAMES},
        "quiet_db": {
            name: {"mean": float(np.mean(levels)), "greatest": max(levels)} for name, levels in quiet_db.items()
        },
        **{key: sum(row[key] for row in rows) for key in ("programs", "pivots", "fallbacks")},
    }


def print_solver_bench(out: Console, result: dict[str, Any]) -> None:
    """A row for each figure and a column for each device."""
    devices = result["devices"]
    grid = Grid("", *(row["device"] for row in devices), title="click solver beside HiGHS, SIMULATED")
    for label, text in _figures():
        grid.add_row(label, *(text(row) for row in devices))
    out.print(grid)
    options = result["options"]
    out.print(
        f"{options['scenarios']} plants optimised over, {options['trimmed']} trimmed on, {options['judged']} fresh; "
        f"times are processor time of one thread; aims: programs {PROGRAMS_RATIO:g} and plants {PLANTS_RATIO:g} times "
        f"as fast, two fingers {TWO_FINGERS_MS[0]:g} and {TWO_FINGERS_MS[1]:g} ms, five {FIVE_FINGERS_MS:g} ms",
        highlight=False,
    )


def _figures() -> Iterator[tuple[str, Callable[[dict[str, Any]], str]]]:
    def seconds(row: dict[str, Any], part: str) -> str:
        times = row["summary"]["processor_s"][part]
        return f"{times['reference']:.1f} / {times['fast']:.2f}"

    yield "states", lambda row: str(len(row["states"]))
    yield "programs: reference / fast, s", lambda row: seconds(row, "programs")
    yield "programs: ratio", lambda row: f"{row['summary']['programs_ratio']:.1f}"
    yield "plants: reference / fast, s", lambda row: seconds(row, "plants")
    yield "once for a device: reference / fast, s", lambda row: seconds(row, "setup")
    yield "plants with that: ratio", lambda row: f"{row['summary']['plants_ratio']:.1f}"
    yield (
        "felt (5 %), fast less reference: least / mean / greatest, dB",
        lambda row: " / ".join(f"{value:+.2f}" for value in row["summary"]["felt_difference_db"].values()),
    )
    yield (
        "quiet (95 %), mean: reference / fast, dB",
        lambda row: " / ".join(f"{row['summary']['quiet_db'][name]['mean']:.2f}" for name in _NAMES[::-1]),
    )
    yield (
        "programs / pivots / fallbacks to HiGHS",
        lambda row: " / ".join(str(row["summary"][key]) for key in ("programs", "pivots", "fallbacks")),
    )
    for fingers, solved in itertools.product(("two_fingers", "five_fingers"), _SOLVED):
        yield (
            f"{fingers.replace('_', ' ')} anywhere, solved {solved}: median / p99 / most, ms",
            lambda row, fingers=fingers, solved=solved: " / ".join(  # type: ignore[misc]  # bound by default
                f"{row[fingers][solved][key]:.0f}" for key in ("median_ms", "p99_ms", "most_ms")
            ),
        )
