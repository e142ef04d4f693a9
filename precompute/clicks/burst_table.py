"""States to the bursts of a table: solved by several processes, sharing the few shapes that a device remembers."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple
from functools import partial
from typing import TypeVar

from engine.device import Device
from engine.table.burst import NUMBER_OF_SHAPES, BurstEntry, Shape
from engine.table.click import LevelSpread
from precompute.clicks.onset_design import ShapedOnset, Steps, choose_steps, fit_each, solve_burst
from precompute.clicks.options import ClickOptions
from precompute.clicks.solver import ClickSolver, chunks_of
from precompute.entries.prediction import States
from precompute.parallel.pool import solve_in_processes

Job = TypeVar("Job")
Result = TypeVar("Result")


def solve_bursts(
    device: Device, options: ClickOptions, states: Sequence[States], workers: int, progress: Callable[[float], None]
) -> tuple[list[BurstEntry], tuple[Shape, ...]]:
    """The bursts of some states, in their order, and the shapes that they share, by so many processes (1: this one).

    `progress` is told the fraction done; they are the same however many solve them. No burst for no state. Raises
    WorkerError where a process was killed.
    """
    found, fitted = dict[States, ShapedOnset](), dict[States, list[ShapedOnset]]()
    for burst in _solve(partial(_begin_burst, device, options), chunks_of(states), workers):
        found[burst.states] = burst
        progress(0.6 * len(found) / len(states))
    steps = [found[state].steps for state in states]
    chunks = [[found[state] for state in chunk] for chunk in chunks_of(states)]
    for row in _solve(partial(_begin_fit, device, options, steps), chunks, workers):
        fitted[row[0].states] = row
        progress(0.6 + 0.4 * len(fitted) / len(states))
    return _tabulated(choose_steps([fitted[state] for state in states], NUMBER_OF_SHAPES))


def _solve(
    begin: Callable[[], Callable[[Job], Result]], chunks: Sequence[Sequence[Job]], workers: int
) -> Iterator[Result]:
    if workers > 1:
        yield from solve_in_processes(begin, chunks, workers)
    elif chunks:
        solve = begin()
        yield from (solve(job) for chunk in chunks for job in chunk)


def _begin_burst(device: Device, options: ClickOptions) -> Callable[[States], ShapedOnset]:
    return partial(solve_burst, ClickSolver(device, options))


def _begin_fit(
    device: Device, options: ClickOptions, steps: Sequence[Steps]
) -> Callable[[ShapedOnset], list[ShapedOnset]]:
    solver = ClickSolver(device, options)
    return lambda burst: fit_each(solver, burst, steps)


def _tabulated(bursts: Sequence[ShapedOnset]) -> tuple[list[BurstEntry], tuple[Shape, ...]]:
    shapes = tuple(dict.fromkeys(burst.steps for burst in bursts))
    return [_entry_of(burst, shapes.index(burst.steps)) for burst in bursts], shapes


def _entry_of(burst: ShapedOnset, shape: int) -> BurstEntry:
    verdict = burst.verdict
    return BurstEntry(
        states=burst.states,
        frequencies_hz=burst.tone.frequencies_hz,
        amplitudes=burst.tone.amplitudes,
        phases_rad=burst.tone.phases_rad,
        shape=shape,
        stop_s=burst.stop_s,
        felt=LevelSpread(*astuple(verdict.felt)),
        quiet=None if verdict.quiet is None else LevelSpread(*astuple(verdict.quiet)),
    )
