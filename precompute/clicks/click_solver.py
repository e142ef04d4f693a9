"""What a click is, and how the click of one placement of the fingers is solved.

A click is a short waveform (30 ms) for each actuator, 0 at both ends, after which some fingers have felt a tick and the
others have not. It differs from a steady drive in that the bar never reaches a steady vibration: what a finger feels is
the transient of all modes, which goes on ringing after the actuators have stopped.

The level of a click under a finger, felt or quiet, is the peak of the acceleration there in dB above the detection
threshold: the acceleration is filtered so that 1 is the threshold at every frequency, and watched until RINGDOWN_S
after the click. Bar and fingers are never known exactly, so a level is a percentile over sampled plants, which vary
stiffnesses, masses, fingers and their places within the device's [spread] or its calibration: 95 % of the plants reach
the felt level, and 95 % stay below the quiet level.

The click of a placement is the waveform with the greatest felt level under which every quiet finger stays below the
quiet level, within the amplitude of the actuators. It is a weighted sum of tones in the actuators' bands under a
half-sine window (click_basis.py), so the acceleration at every instant is linear in the weights (click_plants.py,
click_responses.py). It is solved in closed form over a pool of plants (closed_form.py). The weights are rounded to the
words that travel (`quantise`), the waveform that the device makes of them is evaluated on other plants
(evaluation.py), and only these figures are reported. Tests compare it with a linear program over many more plants.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from base.arrays import Array, Complex32
from engine.device import Device
from engine.table import ClickEntry
from engine.table.clicks import ClickFigures
from engine.touch import Placement
from firmware_link.protocol.basis import (
    SAMPLE_FULL_SCALE,
    Basis,
    BasisSet,
    amplitude_steps,
    quantise_weights,
    weighted_sum,
)
from precompute.clicks.click_basis import click_basis, drive_rows, lines_for, tones_of
from precompute.clicks.click_options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_plants import SampledPlants, count_modes, weighting
from precompute.clicks.click_responses import Responses
from precompute.clicks.closed_form import OF_ROWS, ClosedForm
from precompute.clicks.evaluation import MANY, ManyPlants, evaluate_waveform
from precompute.sampling.plants import sample_deviations, sample_scenarios

_POOLS, _MARGIN_DB = 2, 0.4
"""Where lengths, dampings, bolts or channels vary too, the plants of a pool, times this, and what they are trimmed to
below the quiet level: a pool's 95th percentile is off by so much for all placements. Of 50 clicks for `hand` on each
of four devices 80 to 100 % keep 1 dB with one pool and no margin, 80 to 98 % with two, 98 to 100 % with both, which are
0.3 dB softer.
"""
RESIDUAL_S = 0.03  # time after the end of a click from which its residual is evaluated
_ROUNDING_MARGIN = 2 / SAMPLE_FULL_SCALE


@dataclass(frozen=True)
class QuantisedWeights:
    """Weights (function,) in steps of 2^-fraction_bits, and their base displacements (actuator, time)."""

    words: NDArray[np.int16]
    fraction_bits: int
    waveform: Array


@dataclass(frozen=True)
class Plants:
    """Responses of the plants with which a click is solved, and of those on which it is evaluated."""

    pool: Responses
    judged: Responses


class ClickSolver:
    """Solves clicks of one device; fingers at the same places share the responses of the sampled plants.

    basis: that of the table that the clicks are played with, which another machine may have made: the functions of a
    basis are singular vectors, whose signs differ from one processor to the next. None: a basis of its own.
    """

    def __init__(self, device: Device, options: ClickOptions = DEFAULT_OPTIONS, basis: Basis | None = None) -> None:
        self.device, self.options = device, options
        counts = (options.pool * (_POOLS if device.spread.is_of_bars else 1), options.judged)
        *seeds, self._many_seed = np.random.SeedSequence(options.seed).generate_state(len(counts) + 1).tolist()
        self.scenarios = tuple(sample_scenarios(device, count, seed) for count, seed in zip(counts, seeds, strict=True))
        """Sampled plants to solve with, and to evaluate with."""
        self._threads = ThreadpoolController()
        self.basis = click_basis(device, options) if basis is None else basis
        self.tones = tones_of(self.basis.sets[0])
        self._levels_db = (*device.levels_db, np.inf)
        with self._one_thread():
            lines = lines_for(device, options.length_s)
            modes = count_modes(device, lines)
            self._sampled = [SampledPlants(scenarios, lines, modes) for scenarios in self.scenarios]
            self._weighting = weighting(lines, device.threshold)
            self._closed_form = ClosedForm(self.tones, lines, drive_rows(self.tones, device.limits.amplitude))
        self.plants_of = lru_cache(maxsize=1)(self._compute_plants)  # of all plants, by the fingers' rising positions
        self._many_of = lru_cache(maxsize=16)(self._make_many)

    def solve(self, placement: Placement) -> ClickEntry:
        """The click of one placement, at full strength."""
        with self._one_thread():
            plants = self.plants_of(placement.position_m)
            margin_db = _MARGIN_DB if self.device.spread.is_of_bars else 0.0
            limit = float(10 ** ((self.options.quiet_db - margin_db) / 20))
            many = self._many_of(len(placement.position_m))[0]
            weight = self._closed_form.solve(plants.pool, placement.felt, placement.quiet, limit, many)
            weights = quantise(self.basis.sets[0], weight, self.device.limits.amplitude)
            figures = self.evaluate(placement, weights.waveform)
        tolerance_m = self.options.tolerance_m
        return ClickEntry(
            placement=placement,
            tolerance_m=self.device.spread.reach_m if tolerance_m is None else tolerance_m,
            basis=self.basis,
            basis_set=0,
            weights=weights.words,
            fraction_bits=weights.fraction_bits,
            **vars(figures),
        )

    def evaluate(self, placement: Placement, waveform: Array) -> ClickFigures:
        """Figures of any base displacements (actuator, time), on the plants that clicks are evaluated with."""
        judged, many = self.plants_of(placement.position_m).judged, self._many_of(len(placement.position_m))[1]
        residual_s = self.options.length_s + RESIDUAL_S
        with self._one_thread():
            return evaluate_waveform(waveform, judged, placement, self._weighting, self._levels_db, residual_s, many)

    def _one_thread(self) -> AbstractContextManager[object]:
        """Limit BLAS to one thread: the forms are small, and another order of summation gives another click."""
        return self._threads.limit(limits=1, user_api="blas")

    def _make_many(self, fingers: int) -> tuple[ManyPlants, ManyPlants]:
        """Plants that are not made, beside those that trim and those that are judged, for that many fingers."""
        many = sample_deviations(self.device, MANY, fingers, self._many_seed)
        pool, judged = (
            scenarios.deviations(fingers)[:count]
            for scenarios, count in zip(self.scenarios, self._counts(fingers), strict=True)
        )
        return ManyPlants(pool[OF_ROWS:], many), ManyPlants(judged[1:], many)

    def _counts(self, fingers: int) -> tuple[int, int]:
        """Plants of the pool and to judge with, the nominal ones included.

        The strongest of many fingers differs less from plant to plant: 2 n of them are trimmed and judged on 1/n.
        """
        pool, judged = (len(scenarios) for scenarios in self.scenarios)
        part = max(1, fingers // 2)
        return OF_ROWS + (pool - OF_ROWS) // part, 1 + (judged - 1) // part

    def tones_of_plants(self, position_m: tuple[complex, ...], hz: Array) -> Complex32:
        """Transfer functions (scenario, finger, actuator, tone) of the plants that clicks are judged with, at tones."""
        sampled, count = self._sampled[1], self._counts(len(position_m))[1]
        fingers = sampled.scenarios.place(position_m, self.options.tolerance_m).first(count)
        return sampled.at_tones(hz).transfer(fingers)

    def _compute_plants(self, position_m: tuple[complex, ...]) -> Plants:
        pool, judged = (
            Responses(
                sampled.transfer(sampled.scenarios.place(position_m, self.options.tolerance_m).first(count)),
                sampled.lines,
            )
            for sampled, count in zip(self._sampled, self._counts(len(position_m)), strict=True)
        )
        return Plants(pool, judged)


def quantise(basis_set: BasisSet, weight: Array, amplitude: float) -> QuantisedWeights:
    """Round weights (function,); no sample passes the amplitude."""
    most_steps = amplitude_steps(amplitude)
    while True:
        words, fraction_bits = quantise_weights(weight)
        sums = weighted_sum(basis_set, words, fraction_bits, basis_set.number_of_actuators)
        passed = np.abs(sums).max() / most_steps
        if passed <= 1:
            return QuantisedWeights(words, fraction_bits, sums.T / SAMPLE_FULL_SCALE)
        weight = weight * ((1 - _ROUNDING_MARGIN) / passed)
