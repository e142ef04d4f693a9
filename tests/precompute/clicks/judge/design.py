"""The click of a placement by linear programs over many plants: the judge of the closed form, and slow.

The program sees only some tens of sampled plants, so under a quiet finger its click passes the asked level in more than
5 % of others. Therefore the limit of the program is not the asked quiet level itself: it is trimmed, in a few
secant-like steps, until the 95th percentile over many other plants meets the asked level. A last scaling by a fraction
of a decibel makes it exact.
"""

from dataclasses import dataclass

import numpy as np
from threadpoolctl import ThreadpoolController

from base.arrays import Array, Integers
from engine.device import Device
from engine.touch import Placement
from precompute.clicks.click_basis import SAMPLE_RATE_HZ, click_set, drive_rows, lines_for, tones_of
from precompute.clicks.click_options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_plants import SampledPlants, count_modes
from precompute.clicks.click_responses import Responses
from precompute.clicks.closed_form import SHARE
from precompute.clicks.evaluation import decibels
from precompute.clicks.percentiles import percentiles
from precompute.sampling.plants import sample_scenarios
from tests.precompute.clicks.judge.instants import Search
from tests.precompute.clicks.judge.program import Optimum, Program
from tests.precompute.clicks.judge.watched import WatchedCourses

OPTIMISED, TRIMMED = 40, 800
"""Sampled plants of the programs, and those that their limit is trimmed on."""
_SEARCH_GAIN = 1e-2
"""Instants that promise less than this relative gain of the felt level are not pursued: 0.09 dB."""
_FIRST_LIMIT_DB = -1.0
"""First limit of the program relative to the quiet level, about where trimming ends."""
_CLOSE_DB = 0.03
_SEARCH_AGAIN_DB = 1.0
"""Change of the limit beyond which other instants may be the best, and the first bounds are loose."""
_TRIMS = 6
_FIRST_PLANTS, _FIRST_S = 5, 0.07


@dataclass(frozen=True)
class Design:
    """Weights (tone,) of a click and the base displacements (actuator, time) that they make, in full scales.

    bound_db: upper bound, over all instants tried, on the weakest felt finger in the mean of the optimised plants, for
    any click of the same tones and quiet level; gap_db: distance to it.
    """

    weight: Array
    waveform: Array
    bound_db: float
    gap_db: float


class ProgramSolver:
    """Solves clicks of one device by linear programs; optimised, trimmed: numbers of sampled plants."""

    def __init__(
        self,
        device: Device,
        options: ClickOptions = DEFAULT_OPTIONS,
        optimised: int = OPTIMISED,
        trimmed: int = TRIMMED,
    ) -> None:
        self._device, self._options = device, options
        self._threads = ThreadpoolController()
        seeds = np.random.SeedSequence([options.seed, 1]).generate_state(2).tolist()
        lines = lines_for(device, options.length_s)
        modes = count_modes(device, lines)
        self._sampled = [
            SampledPlants(sample_scenarios(device, count, seed), lines, modes)
            for count, seed in zip((optimised, trimmed), seeds, strict=True)
        ]

    def solve(self, placement: Placement) -> Design:
        """The strongest click within the quiet level."""
        with self._threads.limit(limits=1, user_api="blas"):
            optimised, trimmed = (
                Responses(
                    sampled.transfer(sampled.scenarios.place(placement.position_m, self._options.tolerance_m)),
                    sampled.lines,
                )
                for sampled in self._sampled
            )
            return Designer(self._device, self._options, optimised, trimmed, placement).design()


class Designer:
    """Designs the click of one placement over the responses of some plants, and trims it on those of others."""

    def __init__(
        self, device: Device, options: ClickOptions, optimised: Responses, trimmed: Responses, placement: Placement
    ) -> None:
        self._quiet_db, self._trimmed = options.quiet_db, trimmed
        self.felt, self.quiet = placement.felt, placement.quiet
        self._tones = tones_of(click_set(device, options.length_s, options.crowding))
        watched = WatchedCourses(optimised.under(self.quiet), self._tones)
        program = Program(drive_rows(self._tones, device.limits.amplitude), watched, len(self.felt))
        course = optimised.under(self.felt).mean().play_each(self._tones)[0]
        self.search = Search(program, course, options.length_s, _SEARCH_GAIN)
        if watched.shape[0]:
            program.add(_first_rows(watched))

    def waveform(self, weight: Array) -> Array:
        """Base displacements (actuator, time) of weights (tone,)."""
        return self._tones.waveform(weight)

    def design(self) -> Design:
        """The strongest click within the quiet level, which the limit is moved to, and a last scaling down."""
        limit_db = self._quiet_db + (_FIRST_LIMIT_DB if self.quiet else 0.0)
        found = self.search.strongest(_factor(limit_db))
        aim, optimum = found.aim, found.optimum
        for _ in range(_TRIMS if self.quiet else 0):
            over_db = self._over_db(optimum)
            if abs(over_db) < _CLOSE_DB:
                break
            limit_db -= over_db
            if abs(over_db) >= _SEARCH_AGAIN_DB:
                found = self.search.strongest(_factor(limit_db))
                aim, optimum = found.aim, found.optimum
            else:
                optimum = self.search.improve(aim, _factor(limit_db))
        change_db = min(0.0, -self._over_db(optimum)) if self.quiet else 0.0
        bound_db = float(decibels(max(self.search.bound(_factor(limit_db)), optimum.bound.at(_factor(limit_db)))))
        gap_db = bound_db - float(decibels(optimum.value)) - change_db
        weight = optimum.weight * _factor(change_db)
        return Design(weight, self.waveform(weight), bound_db, gap_db)

    def _over_db(self, optimum: Optimum) -> float:
        """By how much the 95th percentile of the quiet level over the trimmed plants passes the quiet level."""
        level_db = decibels(self._trimmed.peaks(self.waveform(optimum.weight), self.quiet)[1:].max(axis=1))
        return float(percentiles(level_db, (SHARE,))[0]) - self._quiet_db


def _first_rows(watched: WatchedCourses) -> Integers:
    """Watched rows that the pool starts with: every other sample of the first 70 ms in the first plants."""
    scenarios, fingers = watched.responses.transfer.shape[:2]
    course = np.arange(min(scenarios, _FIRST_PLANTS) * fingers)[:, None]
    sample = np.arange(0, min(round(_FIRST_S * SAMPLE_RATE_HZ), watched.shape[1]), 2)
    numbers: Integers = (course * watched.shape[1] + sample).ravel()
    return numbers


def _factor(level_db: float) -> float:
    return float(10 ** (level_db / 20))
