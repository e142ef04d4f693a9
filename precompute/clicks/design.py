"""One state and one length to a waveform: searched, trimmed on other plants, as loud as is wanted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.touch import ZoneState
from precompute.clicks.basis import PLAY_RATE_HZ, Tones, independent, make_tones
from precompute.clicks.evaluation import decibels
from precompute.clicks.options import ClickOptions
from precompute.clicks.program import Optimum, Program
from precompute.clicks.responses import Responses
from precompute.clicks.search import Aim, Search, Strongest
from precompute.clicks.watched import WatchedCourses
from precompute.entries.prediction import States, touched_zones

Array = NDArray[np.float64]

_FIRST_LIMIT_DB = -1.0
"""Below the quiet level: about where trimming ends."""
_ROUGH_DB, _CLOSE_DB = 0.1, 0.03
_SEARCH_AGAIN_DB = 1.0
"""A limit moved by more makes other instants the best, and the bounds of the first search loose."""
_NEAR_DB = 1.5
"""From the 95th percentile: plants further off do not come to it while the limit moves by tenths of a dB."""
_ROUGHLY = 201
"""Plants that are enough to find the limit roughly; the nominal one is one of them."""
_TRIMS = 6
_FIRST_PLANTS, _FIRST_S = 5, 0.07
_MOST_EXCESS_DB = 40.0
_HALVINGS = 10


@dataclass(frozen=True)
class Plants:
    """Responses of the plants that a click is optimised over, trimmed on, and judged by."""

    optimised: Responses
    trimmed: Responses
    judged: Responses


@dataclass(frozen=True)
class Design:
    """Base displacements (actuator, time) as fractions of full scale, and what is known of them as an optimum.

    achieved: in the trimmed plants both levels are as asked. bound_db: no weights of the tones do better at any aim
    that was tried; gap_db: what is left to it.
    """

    waveform: Array
    achieved: bool
    bound_db: float
    gap_db: float


@dataclass(frozen=True)
class Trimmed:
    """The limit in the optimised plants, its optimum, and what quiet fingers keep to in 95 % of the trimmed plants."""

    limit_db: float
    optimum: Optimum
    quiet_db: float


class Designer:
    """Designs the click of one state and length."""

    def __init__(self, device: Device, options: ClickOptions, plants: Plants, states: States, length_s: float) -> None:
        self._options, self._length_s, self._plants = options, length_s, plants
        self.felt, self.quiet = fingers_of(states, ZoneState.FELT), fingers_of(states, ZoneState.QUIET)
        self._tones = independent(make_tones(device, length_s, options.crowding))
        self._amplitude = device.limits.amplitude

    @cached_property
    def search(self) -> Search:
        """Over the optimised plants; whoever only fits a waveform does not need it."""
        watched = self._watched()
        program = Program(drive_rows(self._tones, self._amplitude, self._options.slew_per_s), watched, len(self.felt))
        course = self._plants.optimised.under(self.felt).mean().play_each(self._tones)[0]
        search = Search(program, course, self._length_s)
        if watched.shape[0]:
            program.add(_first_rows(watched))
        return search

    def waveform(self, weight: Array) -> Array:
        """Base displacements (actuator, time) of weights of the tones (tone,) that the search is over."""
        return self._tones.waveform(weight)

    def design(self) -> Design:
        """As strong as can be within the quiet level, or as wanted."""
        limit_db = self._options.quiet_db
        if not self.quiet:
            return self._settle(Trimmed(limit_db, self.search.strongest(_factor(limit_db)).optimum, limit_db))
        limit_db += _FIRST_LIMIT_DB
        return self._settle(self._trim(self.search.strongest(_factor(limit_db)), limit_db))

    def fit(self, waveform: Array) -> Design:
        """Any waveform, as loud as the drive's amplitude and the quiet level allow, or as wanted; the bound is none."""
        full = waveform * (self._amplitude / np.abs(waveform).max())
        if self.quiet:
            full *= _factor(min(0.0, self._options.quiet_db - self._strongest_db(self._plants.trimmed, full)))
        return self._as_wanted(full, np.inf, np.inf)

    def least_violation(self) -> Design | None:
        """The least quiet level above the one asked for at which the wanted level is reached; the bound is none.

        None where the drive alone does not reach it.
        """
        wanted_db = self._options.wanted_db
        aim = self.search.strongest(_factor(self._options.quiet_db)).aim
        assert wanted_db is not None  # nothing else can be out of reach
        low_db, high_db = self._options.quiet_db, self._options.quiet_db + _MOST_EXCESS_DB
        for _ in range(_HALVINGS):
            middle_db = (low_db + high_db) / 2
            reached = self._felt_db(self._best_for(aim, middle_db)) >= wanted_db
            low_db, high_db = (low_db, middle_db) if reached else (middle_db, high_db)
        waveform = self._best_for(aim, high_db)
        spare_db = self._felt_db(waveform) - wanted_db
        if spare_db < 0:
            return None
        waveform *= _factor(-spare_db)
        return Design(waveform, achieved=False, bound_db=np.inf, gap_db=np.inf)

    def _watched(self) -> WatchedCourses:
        """Quiet fingers from the start on, and felt ones from the brake on where there is one."""
        optimised = self._plants.optimised
        fingers, start = list(self.quiet), [0] * len(self.quiet)
        if self._options.brake_s is not None:
            fingers += self.felt
            start += [round(self._options.brake_s * PLAY_RATE_HZ)] * len(self.felt)
        starts = np.tile(np.array(start, dtype=np.int64), len(optimised.transfer))
        return WatchedCourses(optimised.under(fingers), self._tones, starts)

    def _best_for(self, aim: Aim, limit_db: float) -> Array:
        return self.waveform(self.search.improve(aim, _factor(limit_db)).weight)

    def _trim(self, strongest: Strongest, limit_db: float) -> Trimmed:
        """Move the limit until 95 % of the trimmed plants keep to the quiet level: roughly on few plants, then on all.

        Once all were played, only those near the percentile are played again: the others stay on their side of it.
        """
        trimmed, optimum = self._plants.trimmed, strongest.optimum
        few = self._quiet_db(trimmed.first(_ROUGHLY), optimum)
        over_db = _percentile(few, 95) - self._options.quiet_db
        if abs(over_db) >= _ROUGH_DB:
            limit_db -= over_db
            if abs(over_db) >= _SEARCH_AGAIN_DB:
                strongest = self.search.strongest(_factor(limit_db))
                optimum = strongest.optimum
            else:
                optimum = self.search.improve(strongest.aim, _factor(limit_db))
        every_db = self._quiet_db(trimmed, optimum)
        over_db = _percentile(every_db, 95) - self._options.quiet_db
        near = np.flatnonzero(np.abs(every_db - self._options.quiet_db - over_db) < _NEAR_DB)
        close_to = Responses(trimmed.transfer[1:][near], trimmed.lines)
        for _ in range(_TRIMS):
            if abs(over_db) < _CLOSE_DB:
                break
            limit_db -= over_db
            optimum = self.search.improve(strongest.aim, _factor(limit_db))
            every_db[near] = decibels(close_to.peaks(self.waveform(optimum.weight), self.quiet).max(axis=1))
            over_db = _percentile(every_db, 95) - self._options.quiet_db
        return Trimmed(limit_db, optimum, self._options.quiet_db + over_db)

    def _quiet_db(self, plants: Responses, optimum: Optimum) -> Array:
        """Level of the strongest quiet finger in every sampled plant (plant,)."""
        return decibels(plants.peaks(self.waveform(optimum.weight), self.quiet)[1:].max(axis=1))

    def _settle(self, trimmed: Trimmed) -> Design:
        """No louder than the quiet level allows, with the bound that the search has proven at that limit."""
        optimum, limit = trimmed.optimum, _factor(trimmed.limit_db)
        change_db = min(0.0, self._options.quiet_db - trimmed.quiet_db)
        bound_db = float(decibels(max(self.search.bound(limit), optimum.bound.at(limit))))
        gap_db = bound_db - float(decibels(optimum.value)) - change_db
        return self._as_wanted(self.waveform(optimum.weight) * _factor(change_db), bound_db, gap_db)

    def _as_wanted(self, waveform: Array, bound_db: float, gap_db: float) -> Design:
        wanted_db = self._options.wanted_db
        if wanted_db is None:
            return Design(waveform, True, bound_db, gap_db)
        felt_db = self._felt_db(waveform)
        return Design(waveform * _factor(min(0.0, wanted_db - felt_db)), felt_db >= wanted_db, bound_db, gap_db)

    def _felt_db(self, waveform: Array) -> float:
        """What the weakest felt finger exceeds in 95 % of the trimmed plants."""
        peak = self._plants.trimmed.peaks(waveform, self.felt)[1:]
        return _percentile(decibels(peak.min(axis=1)), 5)

    def _strongest_db(self, plants: Responses, waveform: Array) -> float:
        """What the strongest quiet finger keeps to in 95 % of the plants."""
        peak = plants.peaks(waveform, self.quiet)[1:]
        return _percentile(decibels(peak.max(axis=1)), 95)


def fingers_of(states: States, kind: ZoneState) -> list[int]:
    """Which of the fingers, in the order of their zones, lie in zones of that state."""
    return [finger for finger, zone in enumerate(touched_zones(states)) if states[zone] is kind]


def _first_rows(watched: WatchedCourses) -> NDArray[np.int64]:
    """Numbers of the watched rows that a pool begins with: every other sample of the first plants' first 70 ms."""
    scenarios, fingers = watched.responses.transfer.shape[:2]
    course = np.arange(min(scenarios, _FIRST_PLANTS) * fingers)[:, None]
    sample = np.arange(0, round(_FIRST_S * PLAY_RATE_HZ), 2)
    numbers: NDArray[np.int64] = (course * watched.shape[1] + sample)[watched.start[course[:, 0], None] <= sample]
    return numbers


def _percentile(level_db: Array, percent: float) -> float:
    return float(np.percentile(level_db, percent))


def drive_rows(tones: Tones, amplitude: float, slew_per_s: float | None) -> Array:
    """Rows (row, tone) that are within 1 where every displacement is within the amplitude and the slew."""
    actuators: Sequence[int] = np.unique(tones.actuator).tolist()
    rows = list[Array]()
    for actuator in actuators:
        wave = (tones.wave * (tones.actuator == actuator)[:, None]).T
        rows.append(wave[1:-1] / amplitude)
        if slew_per_s is not None:
            rows.append(np.diff(wave, axis=0) * PLAY_RATE_HZ / slew_per_s)
    return np.concatenate(rows)


def _factor(level_db: float) -> float:
    return float(10 ** (level_db / 20))
