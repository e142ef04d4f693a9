"""What a click is, and how the click of one placement of the fingers is solved.

A click is a short waveform (30 ms) for each actuator, 0 at both ends, after which some fingers have felt a tick and the
others have not. It differs from a steady drive in that the bar never reaches a steady vibration: what a finger feels is
the transient of all modes, which goes on ringing after the actuators have stopped.

The level of a click under a finger, felt or quiet, is the peak of the acceleration there in dB above the detection
threshold: the acceleration is filtered so that 1 is the threshold at every frequency, and watched until 0.2 s after the
click. Bar and fingers are never known exactly, so a level is a percentile over sampled plants, which vary stiffnesses,
masses, fingers and their places within the device's [spread] or its calibration: 95 % of the plants reach the felt
level, and 95 % stay below the quiet level.

The click of a placement is the waveform with the greatest felt level under which every quiet finger stays below the
quiet level, within amplitude and slew of the actuators. It is a weighted sum of tones in the actuators' bands under a
half-sine window (basis.py), so the acceleration at every instant is linear in the weights (plants.py, responses.py).
For given instants of the felt peaks the strongest click is therefore a linear program (program.py, solved by
simplex.py); a search chooses the instants (search.py). The program limits the quiet fingers of some tens of plants; its
limit is trimmed until 95 % of many other plants stay below the quiet level (design.py). The weights are rounded to the
words that travel (quantise.py), the waveform that the device makes of them is evaluated on a third sample of plants
(evaluation.py), and only these figures are reported.
`ClickSolver.solve` tries the asked lengths in turn and keeps the first that reaches the wanted level.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from engine.device import Device
from engine.touch import Placement
from precompute.clicks.basis import SAMPLE_RATE_HZ, lines_for
from precompute.clicks.design import Design, Designer, Plants
from precompute.clicks.evaluation import Evaluation, evaluate_waveform
from precompute.clicks.options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.plants import SampledPlants, count_modes
from precompute.clicks.program import Effort
from precompute.clicks.quantise import QuantisedWeights, quantise
from precompute.clicks.responses import Responses
from precompute.sampling.plants import sample_scenarios

Array = NDArray[np.float64]

FULL_SCALE = 32767
"""Full scale of a sample on the wire; waveforms that are of no weights are rounded to it, towards 0."""
PEAK = "peak"
"""Name of the objective of the linear program: the peak under the weakest felt finger."""
RESIDUAL_S = 0.03
"""Time after the end of a click from which its residual is evaluated, unless a brake states the time."""


@dataclass(frozen=True)
class Click:
    """One click: waveform (actuator, time) in fractions of full scale at rate_hz, linear between samples.

    weights: the words of which the device makes this waveform; None for a baseline, which only is evaluated.
    achieved: whether the trimmed plants have the levels that were asked for. If not, the quiet level is exceeded by the
    least that the wanted level takes, or is kept where full scale does not reach the wanted level. bound_db: upper
    bound, over the instants tried, on the weakest felt finger in the mean of the optimised plants, for any click of the
    same tones and quiet level; gap_db: distance to it before the click is scaled down to a wanted level.
    """

    placement: Placement
    objective: str
    rate_hz: float
    length_s: float
    waveform: Array
    weights: QuantisedWeights | None
    evaluation: Evaluation
    achieved: bool
    bound_db: float
    gap_db: float
    effort: Effort


class ClickSolver:
    """Solves clicks of one device; fingers at the same places share the responses of the sampled plants."""

    def __init__(self, device: Device, options: ClickOptions = DEFAULT_OPTIONS) -> None:
        self.device, self.options = device, options
        counts = (options.scenarios, options.trimmed, options.judged)
        seeds = np.random.SeedSequence(options.seed).generate_state(len(counts)).tolist()
        self.scenarios = tuple(sample_scenarios(device, count, seed) for count, seed in zip(counts, seeds, strict=True))
        """Sampled plants to optimise over, to trim on and to evaluate with."""
        self._threads = ThreadpoolController()
        with self._one_thread():
            lines = lines_for(device, options.lengths_s)
            self.modes = count_modes(device, lines)
            self._sampled = [SampledPlants(scenarios, lines, self.modes) for scenarios in self.scenarios]
        self.plants_of = lru_cache(maxsize=1)(self._compute_plants)
        """Responses of all plants with fingers at a tuple of positions, which rise."""

    def solve(self, placement: Placement) -> Click:
        """The click of one placement, of the first length that achieves what is wanted, else of the last length."""
        with self._one_thread():
            return self._solve(placement)

    def evaluate(self, placement: Placement, length_s: float, waveform: Array, objective: str) -> Click:
        """Any base displacements (actuator, time), scaled to the limits and the quiet level; the bound is infinite."""
        with self._one_thread():
            plants = self.plants_of(placement.position_m)
            designer = Designer(self.device, self.options, plants, placement, length_s)
            return self._evaluated(placement, length_s, objective, designer, designer.fit(waveform))

    def _one_thread(self) -> AbstractContextManager[object]:
        """Limit BLAS to one thread: the programs are small, and another order of summation gives another click."""
        limited: AbstractContextManager[object] = self._threads.limit(limits=1, user_api="blas")
        return limited

    def _solve(self, placement: Placement) -> Click:
        misses_before = self.plants_of.cache_info().misses
        plants, tried = self.plants_of(placement.position_m), list[Designer]()
        # The first length that achieves what is wanted is taken.
        for length_s in self.options.lengths_s:
            designer = Designer(self.device, self.options, plants, placement, length_s)
            design = designer.design()
            tried.append(designer)
            if design.achieved:
                break
        else:
            # No length does: of the last one, the click that passes the quiet level least.
            design = (designer.least_violation() if designer.quiet else None) or design
        click = self._evaluated(placement, length_s, PEAK, designer, design)
        # The effort counts the plants that no earlier click had left in the cache.
        computed = (self.plants_of.cache_info().misses - misses_before) * sum(map(len, self.scenarios))
        return replace(click, effort=sum((each.effort for each in tried), Effort(plants=computed)))

    def _evaluated(
        self, placement: Placement, length_s: float, objective: str, designer: Designer, design: Design
    ) -> Click:
        weights, limits = None, self.device.limits
        if design.weight is not None:
            weights = quantise(designer.basis_set, design.weight, limits.amplitude, self.options.slew_per_s)
        waveform = np.trunc(design.waveform * FULL_SCALE) / FULL_SCALE if weights is None else weights.waveform
        brake_s = self.options.brake_s
        plants = self.plants_of(placement.position_m).evaluated
        residual_from_s = length_s + RESIDUAL_S if brake_s is None else brake_s
        return Click(
            placement=placement,
            objective=objective,
            rate_hz=SAMPLE_RATE_HZ,
            length_s=length_s,
            waveform=waveform,
            weights=weights,
            evaluation=evaluate_waveform(waveform, plants, designer.felt, designer.quiet, residual_from_s),
            achieved=design.achieved,
            bound_db=design.bound_db,
            gap_db=design.gap_db,
            effort=Effort(),
        )

    def _compute_plants(self, position_m: tuple[float, ...]) -> Plants:
        optimised, trimmed, evaluated = (
            Responses(sampled.transfer(sampled.scenarios.place(position_m, self.options.tolerance_m)), sampled.lines)
            for sampled in self._sampled
        )
        return Plants(optimised, trimmed, evaluated)
