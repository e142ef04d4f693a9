"""A state of the fingers to its click: a short waveform that felt fingers feel and quiet ones do not."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from engine.device import Device
from precompute.clicks.basis import PLAY_RATE_HZ, lines_for
from precompute.clicks.design import Design, Designer, Plants
from precompute.clicks.evaluation import Verdict, judge_waveform
from precompute.clicks.options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.plants import SampledPlants, count_modes
from precompute.clicks.responses import Responses
from precompute.entries.prediction import States, touched_zones
from precompute.parallel.pool import solve_in_processes
from precompute.sampling.plants import sample_scenarios

Array = NDArray[np.float64]

FULL_SCALE = 32767
"""Of a sample on the wire; waveforms are rounded to it, towards 0, before they are judged."""
PEAK = "peak"
"""The objective of the linear program: the greatest peak under the weakest felt finger."""
RESIDUAL_S = 0.03
"""From so long after its end what is left of a click counts as residual, where no brake says when."""
_MOST_TOGETHER = 16
"""States that one process solves before it asks for others: fewer share less, more keep some processes waiting."""


@dataclass(frozen=True)
class Click:
    """One click: waveform (actuator, time) in fractions of full scale at rate_hz, straight lines between samples.

    achieved: the plants that it was trimmed on have the levels that were asked for; where they have not, the quiet
    level is exceeded by the least that the wanted one takes, or kept where full scale does not reach the wanted one.
    bound_db: what no click of its tones and its quiet level exceeds at any instant tried, the weakest felt finger
    averaged over the scenarios; gap_db: what is left to it, before the click is scaled down to a wanted level.
    """

    states: States
    objective: str
    rate_hz: float
    length_s: float
    waveform: Array
    verdict: Verdict
    achieved: bool
    bound_db: float
    gap_db: float


def solve_clicks(device: Device, options: ClickOptions, states: Sequence[States], workers: int = 1) -> Iterator[Click]:
    """The clicks of some states of the device, in any order, by so many processes (1: this one).

    They are the same however many solve them. Raises WorkerError where a process was killed.
    """
    chunks = chunks_of(states)
    if not chunks:
        return
    if workers == 1:
        solver = ClickSolver(device, options)
        yield from (solver.solve(state) for chunk in chunks for state in chunk)
    else:
        yield from solve_in_processes(partial(_begin, device, options), chunks, workers)


def _begin(device: Device, options: ClickOptions) -> Callable[[States], Click]:
    return ClickSolver(device, options).solve


def chunks_of(states: Sequence[States]) -> list[list[States]]:
    """States with the same fingers together, so that they share what is computed for them; the longest work first."""
    alike = [list(group) for _, group in groupby(sorted(states, key=touched_zones), key=touched_zones)]
    chunks = [
        group[start : start + _MOST_TOGETHER] for group in alike for start in range(0, len(group), _MOST_TOGETHER)
    ]
    return sorted(chunks, key=lambda chunk: -len(chunk) * len(touched_zones(chunk[0])))


class ClickSolver:
    """Solves states of one device; what states with the same fingers share is computed once."""

    def __init__(self, device: Device, options: ClickOptions = DEFAULT_OPTIONS) -> None:
        self.device, self.options = device, options
        counts = (options.scenarios, options.trimmed, options.judged)
        seeds = np.random.SeedSequence(options.seed).generate_state(len(counts)).tolist()
        self.scenarios = tuple(sample_scenarios(device, count, seed) for count, seed in zip(counts, seeds, strict=True))
        """Those optimised over, trimmed on, judged by."""
        self._threads = ThreadpoolController()
        with self._one_thread():
            lines = lines_for(device, options.lengths_s)
            self.modes = count_modes(device, lines)
            self._sampled = [SampledPlants(scenarios, lines, self.modes) for scenarios in self.scenarios]
        self.plants_of = lru_cache(maxsize=1)(self._compute_plants)
        """Responses with a finger in each of some zones (indices, a tuple)."""

    def solve(self, states: States) -> Click:
        """The click of one state: of the first length that achieves what is wanted, else of the last."""
        with self._one_thread():
            return self._solve(states)

    def judge(self, states: States, length_s: float, waveform: Array, objective: str) -> Click:
        """Any base displacements (actuator, time), as loud as limits and quiet level allow; it claims no optimum."""
        with self._one_thread():
            designer = Designer(self.device, self.options, self.plants_of(touched_zones(states)), states, length_s)
            return self._judged(states, length_s, objective, designer, designer.fit(waveform))

    def _one_thread(self) -> AbstractContextManager[object]:
        """Of BLAS: programs are small, and sums in another order end in another click."""
        limited: AbstractContextManager[object] = self._threads.limit(limits=1, user_api="blas")
        return limited

    def _solve(self, states: States) -> Click:
        plants = self.plants_of(touched_zones(states))
        for length_s in self.options.lengths_s:
            designer = Designer(self.device, self.options, plants, states, length_s)
            design = designer.design()
            if design.achieved:
                break
        else:
            design = (designer.least_violation() if designer.quiet else None) or design
        return self._judged(states, length_s, PEAK, designer, design)

    def _judged(self, states: States, length_s: float, objective: str, designer: Designer, design: Design) -> Click:
        waveform = np.fix(design.waveform * FULL_SCALE) / FULL_SCALE
        brake_s = self.options.brake_s
        judged = self.plants_of(touched_zones(states)).judged
        residual_from_s = length_s + RESIDUAL_S if brake_s is None else brake_s
        return Click(
            states=states,
            objective=objective,
            rate_hz=PLAY_RATE_HZ,
            length_s=length_s,
            waveform=waveform,
            verdict=judge_waveform(waveform, judged, designer.felt, designer.quiet, residual_from_s),
            achieved=design.achieved,
            bound_db=design.bound_db,
            gap_db=design.gap_db,
        )

    def _compute_plants(self, touched: tuple[int, ...]) -> Plants:
        optimised, trimmed, judged = (
            Responses(sampled.transfer(sampled.fingers_in(touched)), sampled.lines) for sampled in self._sampled
        )
        return Plants(optimised, trimmed, judged)
