"""The click of a placement by linear programs over sampled plants: slow, and what the closed form is compared with.

For one instant and sign of every felt finger's peak, the strongest click is a linear program: the weights of tones with
the greatest response of the weakest felt finger, within the amplitude of the drive, and within a limit under the quiet
fingers of every plant at every instant. All felt fingers first share an instant of a grid; from the best one, each
finger is given the instant of its own peak while that brings more. The plants of the program are few, so its limit is
moved until the 95th percentile over many other plants is the quiet level.
"""

import itertools

import numpy as np
from scipy.optimize import linprog

from base.arrays import Array
from engine.device import Device
from engine.touch import Placement
from precompute.clicks.click_basis import (
    EVALUATION_RATE_HZ,
    EVALUATIONS_PER_SAMPLE,
    click_set,
    drive_rows,
    lines_for,
    tones_of,
)
from precompute.clicks.click_options import ClickOptions
from precompute.clicks.click_plants import SampledPlants
from precompute.clicks.click_responses import Responses
from precompute.clicks.closed_form import SHARE
from precompute.clicks.evaluation import decibels
from precompute.sampling.plants import sample_scenarios
from tests.precompute.clicks.click_cases import mean_plant, play_each

OPTIMISED, TRIMMED = 10, 200
"""Sampled plants of the programs, and those that their limit is moved on."""
STEP_S, AFTER_S = 8e-3, 2e-3
"""Common instants lie so far apart, from the middle of the click until this long after its end."""
_OVER, _ABOUT = 1e-4, 5e-2
"""Relative violations that are tolerated in a click, and where common instants are only compared."""
_CLOSE_DB, _FIRST_DB, _TRIMS = 0.1, -1.0, 4


class Program:
    """Maximises the smallest of aims @ weight where |drive @ weight| <= 1 and |quiet @ weight| <= limit.

    Of the quiet rows (course, time, tone) those that pass the limit are let in, until none does.
    """

    def __init__(self, drive: Array, quiet: Array) -> None:
        self._drive, self._quiet, self._entered = drive, quiet, quiet[:0, 0]

    def maximise(self, aims: Array, limit: float, tolerated: float = _OVER) -> Array:
        """The best weights (tone,) for aims (aim, tone)."""
        goals = np.column_stack([-aims, np.ones(len(aims))])
        cost = np.append(np.zeros(aims.shape[1]), -1.0)
        while True:
            rows = np.concatenate([self._drive, self._entered / limit])
            rows = np.column_stack([np.concatenate([rows, -rows]), np.zeros(2 * len(rows))])
            right = np.append(np.ones(len(rows)), np.zeros(len(goals)))
            found = linprog(cost, np.concatenate([rows, goals]), right, bounds=(None, None)).x
            assert found is not None  # no weights at all are within every limit
            weight = found[:-1]
            course = abs(self._quiet @ weight)
            over = np.flatnonzero(course.max(axis=1, initial=0.0) > limit * (1 + tolerated))
            if not len(over):
                return weight
            self._entered = np.concatenate([self._entered, self._quiet[over, course[over].argmax(axis=1)]])


def strongest_click(device: Device, options: ClickOptions, placement: Placement) -> Array:
    """Base displacements (actuator, time) in full scales of the strongest click within the quiet level."""
    tones, lines = tones_of(click_set(device, options.length_s, options.crowding)), lines_for(device, options.length_s)
    optimised, trimmed = (
        Responses(plants.transfer(plants.scenarios.place(placement.position_m, options.tolerance_m)), lines)
        for plants in (SampledPlants(sample_scenarios(device, count, count), lines) for count in (OPTIMISED, TRIMMED))
    )
    felt = play_each(mean_plant(optimised.under(placement.felt)), tones)[0]
    quiet = play_each(optimised.under(placement.quiet), tones)[:, :, ::EVALUATIONS_PER_SAMPLE]
    quiet = quiet.reshape(-1, *quiet.shape[2:])
    program = Program(drive_rows(tones, device.limits.amplitude), quiet)

    def over_db(weight: Array) -> float:
        peak_db = decibels(trimmed.peaks(tones.waveform(weight), placement.quiet)[1:].max(axis=1))
        return float(np.percentile(peak_db, SHARE)) - options.quiet_db

    limit_db = options.quiet_db + _FIRST_DB
    aims, weight = _best_aims(program, felt, options.length_s, _factor(limit_db))
    for _ in range(_TRIMS):
        if abs(over_db(weight)) < _CLOSE_DB:
            break
        limit_db -= over_db(weight)
        weight = program.maximise(aims, _factor(limit_db))
    return tones.waveform(weight * _factor(min(0.0, -over_db(weight))))


def _best_aims(program: Program, felt: Array, length_s: float, limit: float) -> tuple[Array, Array]:
    """Rows (finger, tone) of the best instants and signs of felt (finger, time, tone), and the weights they get."""
    instants = np.round(np.arange(length_s / 2, length_s + AFTER_S, STEP_S) * EVALUATION_RATE_HZ).astype(int)
    signs = [np.array([1.0, *rest])[:, None] for rest in itertools.product((1.0, -1.0), repeat=len(felt) - 1)]
    tried = [felt[:, instant] * sign for instant in instants for sign in signs]
    found = [(aims, program.maximise(aims, limit, _ABOUT)) for aims in tried]
    aims = max(found, key=lambda each: _value(*each))[0]
    best = aims, program.maximise(aims, limit)
    while True:
        course = felt @ best[1]
        peak = np.arange(len(felt)), abs(course).argmax(axis=1)
        aims = felt[peak] * np.sign(course[peak])[:, None]
        ascended = aims, program.maximise(aims, limit)
        if _value(*ascended) <= _value(*best) * (1 + _OVER):
            return best
        best = ascended


def _value(aims: Array, weight: Array) -> float:
    return float((aims @ weight).min())


def _factor(level_db: float) -> float:
    return float(10 ** (level_db / 20))
