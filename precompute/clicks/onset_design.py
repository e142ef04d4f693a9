"""A state to a burst that firmware without waveforms can play: a drive behind timed amplitude steps, then silence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution

from engine.table import Entry
from engine.table.burst import SHAPE_FULL_GAIN, SHAPE_STEPS, SHAPE_TIME_US, OnsetStep
from engine.touch import ZoneState
from precompute.clicks.basis import PLAY_RATE_HZ, Responses
from precompute.clicks.design import fingers_of
from precompute.clicks.evaluation import Verdict, decibels, judge_waveform
from precompute.clicks.solver import RESIDUAL_S, ClickSolver
from precompute.entries.candidate import on_the_wire
from precompute.entries.prediction import States, touched_zones

Array = NDArray[np.float64]
Steps = tuple[OnsetStep, ...]

_SOFTEST_END = 0.1
"""What follows the steps is no softer than so, relative to the loudest: the wire gives gains relative to it."""
_SHORTEST = 0.3
"""Of the longest burst."""
_STOPS = 15
_COURSE = 2 * SHAPE_STEPS + 2
_POPULATION, _GENERATIONS = 7, 30
"""Of differential evolution, the first for each unknown."""
_FITS = 3
_US_PER_S = 1e6


@dataclass(frozen=True)
class Tone:
    """What a SET asks for, per actuator: frequencies, amplitudes as fractions of full scale, phases of a sine."""

    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]


@dataclass(frozen=True)
class ShapedOnset:
    """A burst of one state: `tone` behind the steps, until `stop_s` after its start, when the amplitudes are set to 0.

    Steps hold a gain on the amplitudes until their time, common to all actuators, as a SHAPE of the wire does; every
    change passes the slew of the device's limits. waveform: the base displacements (actuator, time) that follow, at
    precompute.clicks.basis.PLAY_RATE_HZ; verdict: of plants that it was not found by.
    """

    states: States
    tone: Tone
    steps: Steps
    stop_s: float
    waveform: Array
    verdict: Verdict


def solve_onset(solver: ClickSolver, entry: Entry) -> ShapedOnset:
    """The burst of a steady entry's own drive that its felt fingers feel most.

    No longer than the clicks of the solver; quiet fingers keep to the level of its options in 95 % of the plants that
    it trims on. Found by differential evolution (seeded) over its optimised plants, so another may be better.
    """
    shaper, tone = _Shaper(solver, entry.states), _tone_of(entry)
    point = _evolve(lambda x: -shaper.reach_db(tone, *shaper.course(x)), _COURSE, solver.options.seed)
    return shaper.fitted(tone, *shaper.course(point))


def solve_burst(solver: ClickSolver, states: States) -> ShapedOnset:
    """The same with any drive in the bands of the actuators: a burst is over before its drive is steady."""
    shaper, actuators = _Shaper(solver, states), solver.device.actuators
    low_hz, high_hz = np.array([actuator.band_hz for actuator in actuators]).T

    def parts(x: Array) -> tuple[Tone, Steps, float]:
        frequency, amplitude, phase = x[_COURSE:].reshape(3, -1)
        frequency_hz = on_the_wire(low_hz + (high_hz - low_hz) * frequency)
        amplitude = amplitude / max(float(amplitude.max()), 1.0 / _US_PER_S)
        tone = Tone(tuple(frequency_hz.tolist()), tuple(amplitude.tolist()), tuple((2 * np.pi * phase).tolist()))
        return tone, *shaper.course(x[:_COURSE])

    point = _evolve(lambda x: -shaper.reach_db(*parts(x)), _COURSE + 3 * len(actuators), solver.options.seed)
    return shaper.fitted(*parts(point))


def fit_steps(solver: ClickSolver, onset: ShapedOnset, steps: Sequence[OnsetStep]) -> ShapedOnset:
    """The burst with other steps, of the length and the loudness that its felt fingers feel most."""
    shaper = _Shaper(solver, onset.states)
    stops_s = [*(np.linspace(_SHORTEST, 1.0, _STOPS) * shaper.longest_s).tolist(), onset.stop_s]
    best_s = max(stops_s, key=lambda stop_s: shaper.reach_db(onset.tone, tuple(steps), stop_s))
    return shaper.fitted(onset.tone, tuple(steps), best_s)


def fit_each(solver: ClickSolver, onset: ShapedOnset, steps: Sequence[Steps]) -> list[ShapedOnset]:
    """The burst with each of these steps."""
    return [fit_steps(solver, onset, each) for each in steps]


def choose_steps(fitted: Sequence[Sequence[ShapedOnset]], most: int) -> list[ShapedOnset]:
    """The burst of each row, with at most so many different steps among them, for a device remembers few.

    Row by row one state's bursts, all rows with the same steps in the same order. Steps are taken one after another,
    each time those that add most to the sum of felt levels (greedy k-medoids).
    """
    felt_db = np.array([[burst.verdict.felt.low_db for burst in row] for row in fitted])
    chosen = list[int]()
    for _ in range(min(most, len(fitted))):
        have_db = felt_db[:, chosen].max(axis=1, initial=-np.inf)[:, None]
        chosen.append(int(np.maximum(felt_db, have_db).sum(axis=0).argmax()))
    return [row[max(chosen, key=levels_db.__getitem__)] for row, levels_db in zip(fitted, felt_db, strict=True)]


class _Shaper:
    """The bursts of one state, and what is felt of them."""

    def __init__(self, solver: ClickSolver, states: States) -> None:
        self._states, self._options, self._limits = states, solver.options, solver.device.limits
        self._felt, self._quiet = (fingers_of(states, kind) for kind in (ZoneState.FELT, ZoneState.QUIET))
        self._plants = solver.plants_of(touched_zones(states))
        self._length_s = max(self._options.lengths_s)
        self._time_s = np.arange(round(self._length_s * PLAY_RATE_HZ) + 1) / PLAY_RATE_HZ
        self.longest_s = self._length_s - self._limits.amplitude / self._limits.slew_per_s
        """It must have faded when the length is over."""

    def course(self, x: Array) -> tuple[Steps, float]:
        """Steps and stop of a point (_COURSE,) of the unit cube: ends of steps, how loud they and the rest are."""
        stop_s = float(_SHORTEST + (1 - _SHORTEST) * x[_COURSE - 1]) * self.longest_s
        level = x[SHAPE_STEPS:-1] / max(float(x[SHAPE_STEPS:-1].max()), 1.0 / SHAPE_FULL_GAIN)
        gain = level[:-1] / max(float(level[-1]), _SOFTEST_END)
        tick_s = SHAPE_TIME_US / _US_PER_S
        ends_s = np.round(np.sort(x[:SHAPE_STEPS]) * stop_s / tick_s) * tick_s
        rounded = np.round(gain * SHAPE_FULL_GAIN) / SHAPE_FULL_GAIN
        return tuple(OnsetStep(*step) for step in zip(ends_s.tolist(), rounded.tolist(), strict=True)), stop_s

    def reach_db(self, tone: Tone, steps: Steps, stop_s: float) -> float:
        """What the weakest felt finger exceeds in 95 % of the plants, as loud as full scale and quiet level allow."""
        waveform = self._waveform(tone, steps, stop_s, self._loudest(tone, steps))
        felt_db, quiet_db = self._levels_db(self._plants.optimised, waveform)
        return felt_db + min(0.0, self._options.quiet_db - quiet_db)

    def fitted(self, tone: Tone, steps: Steps, stop_s: float) -> ShapedOnset:
        """As loud as full scale and, in the trimmed plants, the quiet level allow; judged by others."""
        factor = self._loudest(tone, steps)
        for _ in range(_FITS):  # a softer drive has shorter ramps: not all of it gets softer
            _, quiet_db = self._levels_db(self._plants.trimmed, self._waveform(tone, steps, stop_s, factor))
            factor *= 10 ** (min(0.0, self._options.quiet_db - quiet_db) / 20)
        waveform = self._waveform(tone, steps, stop_s, factor)
        brake_s = self._options.brake_s
        residual_from_s = self._length_s + RESIDUAL_S if brake_s is None else brake_s
        verdict = judge_waveform(waveform, self._plants.judged, self._felt, self._quiet, residual_from_s)
        amplitudes = tuple(factor * amplitude for amplitude in tone.amplitudes)
        return ShapedOnset(
            self._states, Tone(tone.frequencies_hz, amplitudes, tone.phases_rad), steps, stop_s, waveform, verdict
        )

    def _loudest(self, tone: Tone, steps: Steps) -> float:
        """The factor with which the loudest step is at the limit."""
        return self._limits.amplitude / (max(tone.amplitudes) * max(1.0, *[step.gain for step in steps]))

    def _levels_db(self, plants: Responses, waveform: Array) -> tuple[float, float]:
        """The weakest felt finger's 5 %, the strongest quiet one's 95 %; with nothing quiet the level asked for."""
        level_db = decibels(plants.peaks(waveform, [*self._felt, *self._quiet])[1:])
        felt_db = float(np.percentile(level_db[:, : len(self._felt)].min(axis=1), 5))
        if not self._quiet:
            return felt_db, self._options.quiet_db
        return felt_db, float(np.percentile(level_db[:, len(self._felt) :].max(axis=1), 95))

    def _waveform(self, tone: Tone, steps: Steps, stop_s: float, factor: float) -> Array:
        """Shape (actuator, time): every amplitude follows its target at the slew, from silence to silence."""
        starts_s = [0.0, *[min(step.until_s, stop_s) for step in steps], stop_s, self._length_s]
        gains = [*[step.gain for step in steps], 1.0, 0.0]
        turn = 2 * np.pi * np.outer(tone.frequencies_hz, self._time_s) + np.array(tone.phases_rad)[:, None]
        waveform: Array = np.sin(turn)
        for row, amplitude in zip(waveform, tone.amplitudes, strict=True):
            targets = [min(gain * factor * amplitude, self._limits.amplitude) for gain in gains]
            row *= self._slewed(starts_s, targets)
        waveform[:, [0, -1]] = 0  # where rounding leaves something
        return waveform

    def _slewed(self, starts_s: Sequence[float], targets: Sequence[float]) -> Array:
        """An amplitude over time that moves from 0 towards each target from its start on, at the slew."""
        knots_s, reached = [0.0], [0.0]
        for (start_s, stop_s), target in zip(pairwise(starts_s), targets, strict=True):
            change = target - reached[-1]
            needed_s = abs(change) / self._limits.slew_per_s
            share = min(1.0, (stop_s - start_s) / needed_s) if needed_s else 1.0
            knots_s += [start_s + share * needed_s, stop_s]
            reached += [reached[-1] + share * change] * 2
        return np.interp(self._time_s, knots_s, reached)


def _tone_of(entry: Entry) -> Tone:
    return Tone(entry.frequencies_hz, entry.amplitudes, entry.phases_rad)


def _evolve(loss: Callable[[Array], float], unknowns: int, seed: int) -> Array:
    """The best point found in the unit cube (unknowns,)."""
    found = differential_evolution(
        loss,
        Bounds([0.0] * unknowns, [1.0] * unknowns),
        popsize=_POPULATION,
        maxiter=_GENERATIONS,
        rng=np.random.default_rng(seed),
        polish=False,
        init="sobol",
    )
    return np.asarray(found.x, dtype=np.float64)
