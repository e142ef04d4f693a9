"""A state's steady entry to a short burst that plain firmware can play: timed amplitude steps, then silence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from engine.entry import Entry
from engine.zones import ZoneState
from firmware_link.messages import SHAPE_FULL_GAIN, SHAPE_STEPS, SHAPE_TIME_US
from firmware_link.onset import OnsetStep
from precompute.click import RESIDUAL_S, ClickSolver
from precompute.click_basis import PLAY_RATE_HZ, Responses
from precompute.click_design import fingers_of
from precompute.click_judge import Verdict, decibels, judge_waveform
from precompute.promise import touched_zones

Array = NDArray[np.float64]

_SOFTEST_END = 0.1
"""Of full scale, relative to the loudest step: gains are given relative to the last one."""
_SHORTEST = 0.3
"""Of the longest burst."""
_POPULATION, _GENERATIONS = 8, 24
_FITS = 3
_US_PER_S = 1e6


@dataclass(frozen=True)
class ShapedOnset:
    """A burst: the entry at `amplitude` times its own amplitudes, behind the steps, until `stop_s` after its start.

    Steps hold a gain on that amplitude until their time, common to all actuators, as a SHAPE of the wire does; every
    change passes the slew of the device's limits. waveform: the base displacements (actuator, time) that follow.
    """

    entry: Entry
    steps: tuple[OnsetStep, ...]
    stop_s: float
    amplitude: float
    waveform: Array
    verdict: Verdict


def solve_onset(solver: ClickSolver, entry: Entry) -> ShapedOnset:
    """The burst of the entry, no longer than the clicks of the solver, that its felt fingers feel most.

    The quiet level is that of the solver's options: kept in 95 % of the plants that it trims on. Found by differential
    evolution (seeded) over the optimised plants; what the firmware rounds is rounded here.
    """
    shaper = _Shaper(solver, entry)

    def loss(x: Array) -> float:
        return -shaper.reach_db(*shaper.shape(x), shaper.optimised)

    found = differential_evolution(
        loss,
        [(0.0, 1.0)] * (2 * SHAPE_STEPS + 2),
        popsize=_POPULATION,
        maxiter=_GENERATIONS,
        rng=np.random.default_rng(solver.options.seed),
        polish=False,
        init="sobol",
    )
    return shaper.fitted(*shaper.shape(found.x))


def fit_steps(solver: ClickSolver, entry: Entry, steps: Sequence[OnsetStep]) -> ShapedOnset:
    """The burst of the entry behind given steps, of the length and the loudness that its felt fingers feel most."""
    shaper = _Shaper(solver, entry)
    stops_s = np.linspace(_SHORTEST, 1.0, 15) * shaper.longest_s
    best_s = max(stops_s.tolist(), key=lambda stop_s: shaper.reach_db(tuple(steps), stop_s, shaper.optimised))
    return shaper.fitted(tuple(steps), best_s)


def share_steps(solver: ClickSolver, onsets: Sequence[ShapedOnset], most: int) -> list[ShapedOnset]:
    """The same states with at most so many different shapes among them, for devices remember few.

    Shapes are taken from the onsets one after another, each time the one that helps the sum of felt levels most
    (greedy k-medoids); every state then plays the best of them.
    """
    felt_db = np.empty((len(onsets), len(onsets)))
    fitted = [[fit_steps(solver, onset.entry, other.steps) for other in onsets] for onset in onsets]
    for row, bursts in enumerate(fitted):
        felt_db[row] = [burst.verdict.felt.low_db for burst in bursts]
    chosen = list[int]()
    for _ in range(min(most, len(onsets))):
        have = felt_db[:, chosen].max(axis=1, initial=-np.inf)[:, None]
        chosen.append(int(np.maximum(felt_db, have).sum(axis=0).argmax()))
    return [bursts[max(chosen, key=lambda shape: felt_db[row, shape])] for row, bursts in enumerate(fitted)]


class _Shaper:
    """The bursts of one entry, and what is felt of them."""

    def __init__(self, solver: ClickSolver, entry: Entry) -> None:
        self._entry, self._options, self._limits = entry, solver.options, solver.device.limits
        self._felt, self._quiet = (fingers_of(entry.states, kind) for kind in (ZoneState.FELT, ZoneState.QUIET))
        plants = solver.plants_of(touched_zones(entry.states))
        self.optimised, self._trimmed, self._judged = plants.optimised, plants.trimmed, plants.judged
        self._length_s = max(self._options.lengths_s)
        loudest = max(entry.amplitudes)
        self._full = self._limits.amplitude / loudest
        self.longest_s = self._length_s - self._limits.amplitude / self._limits.slew_per_s
        time_s = np.arange(round(self._length_s * PLAY_RATE_HZ) + 1) / PLAY_RATE_HZ
        turn = 2 * np.pi * np.outer(entry.frequencies_hz, time_s) + np.array(entry.phases_rad)[:, None]
        self._time_s, self._tone = time_s, np.sin(turn)

    def shape(self, x: Array) -> tuple[tuple[OnsetStep, ...], float]:
        """Steps and stop of a point of the unit cube: when each step ends, how loud they and what follows are, stop."""
        until, level, stop = np.sort(x[:SHAPE_STEPS]), x[SHAPE_STEPS:-1], x[-1]
        level = np.maximum(level / level.max(), [*[0.0] * SHAPE_STEPS, _SOFTEST_END])
        stop_s = float(_SHORTEST + (1 - _SHORTEST) * stop) * self.longest_s
        tick = SHAPE_TIME_US / _US_PER_S
        steps = tuple(
            OnsetStep(round(float(end) * stop_s / tick) * tick, round(float(gain) * SHAPE_FULL_GAIN) / SHAPE_FULL_GAIN)
            for end, gain in zip(until, level[:-1] / level[-1], strict=True)
        )
        return steps, stop_s

    def reach_db(self, steps: tuple[OnsetStep, ...], stop_s: float, plants: Responses) -> float:
        """What the weakest felt finger exceeds in 95 % of the plants, as loud as full scale and quiet level allow."""
        waveform = self._waveform(steps, stop_s, self._loudest(steps))
        felt_db, quiet_db = self._levels_db(plants, waveform)
        return felt_db + min(0.0, self._options.quiet_db - quiet_db)

    def fitted(self, steps: tuple[OnsetStep, ...], stop_s: float) -> ShapedOnset:
        """As loud as full scale and, in the trimmed plants, the quiet level allow; judged by others."""
        amplitude = self._loudest(steps)
        for _ in range(_FITS):  # a softer drive has shorter ramps: not all of it gets softer
            _, quiet_db = self._levels_db(self._trimmed, self._waveform(steps, stop_s, amplitude))
            amplitude *= 10 ** (min(0.0, self._options.quiet_db - quiet_db) / 20)
        waveform = self._waveform(steps, stop_s, amplitude)
        residual_from_s = self._length_s + RESIDUAL_S if self._options.brake_s is None else self._options.brake_s
        verdict = judge_waveform(waveform, self._judged, self._felt, self._quiet, residual_from_s)
        return ShapedOnset(self._entry, steps, stop_s, amplitude, waveform, verdict)

    def _loudest(self, steps: tuple[OnsetStep, ...]) -> float:
        return self._full / max(1.0, *[step.gain for step in steps])

    def _levels_db(self, plants: Responses, waveform: Array) -> tuple[float, float]:
        """The weakest felt finger's 5 %, the strongest quiet one's 95 %; without one the quiet level asked for."""
        level_db = decibels(plants.peaks(waveform, [*self._felt, *self._quiet])[1:])
        felt_db = float(np.percentile(level_db[:, : len(self._felt)].min(axis=1), 5))
        if not self._quiet:
            return felt_db, self._options.quiet_db
        return felt_db, float(np.percentile(level_db[:, len(self._felt) :].max(axis=1), 95))

    def _waveform(self, steps: tuple[OnsetStep, ...], stop_s: float, amplitude: float) -> Array:
        """Shape (actuator, time): every amplitude follows its target at the slew, from silence to silence."""
        gain = np.ones(len(self._time_s))
        for step in reversed(steps):
            gain[self._time_s < step.until_s] = step.gain
        gain[self._time_s >= stop_s] = 0
        most = self._limits.slew_per_s / PLAY_RATE_HZ
        reached = np.zeros(len(self._entry.amplitudes))
        target = np.minimum(np.outer(gain, amplitude * np.array(self._entry.amplitudes)), self._limits.amplitude)
        envelope = np.empty(target.shape)
        for index, wanted in enumerate(target):
            envelope[index] = reached
            reached = reached + np.clip(wanted - reached, -most, most)
        return envelope.T * self._tone
