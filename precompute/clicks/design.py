"""Design of one click of one length: search on a few plants, trim on many, scale to the level that is wanted.

The linear program sees only some tens of sampled plants (`optimised`), so under a quiet finger the click passes the
asked level in more than 5 % of others. Therefore the limit of the program is not the asked quiet level itself: it is
trimmed, in a few secant-like steps, until the 95th percentile over many other plants (`trimmed`) meets the asked level.
A last scaling by a fraction of a decibel makes it exact. Figures that are reported come from a third sample
(`evaluated`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.touch import Placement
from precompute.clicks.basis import SAMPLE_RATE_HZ, Tones, click_set, tones_of
from precompute.clicks.evaluation import decibels
from precompute.clicks.options import ClickOptions
from precompute.clicks.program import Effort, Optimum, Program
from precompute.clicks.responses import Responses
from precompute.clicks.search import Aim, Found, Search
from precompute.clicks.watched import WatchedCourses

Array = NDArray[np.float64]

_FIRST_LIMIT_DB = -1.0
"""First limit of the program relative to the quiet level, about where trimming ends."""
_ROUGH_DB, _CLOSE_DB = 0.1, 0.03
_SEARCH_AGAIN_DB = 1.0
"""Change of the limit beyond which other instants may be the best, and the first bounds are loose."""
_NEAR_DB = 1.5
"""Distance from the 95th percentile beyond which a plant keeps its side while the limit moves by tenths of a dB."""
_ROUGHLY = 201
"""Plants for the first, rough trim, the nominal one included."""
_TRIMS = 6
_FIRST_PLANTS, _FIRST_S = 5, 0.07
_MOST_EXCESS_DB = 40.0
_HALVINGS = 10


@dataclass(frozen=True)
class Plants:
    """Responses of the plants over which a click is optimised, trimmed and evaluated."""

    optimised: Responses
    trimmed: Responses
    evaluated: Responses


@dataclass(frozen=True)
class Design:
    """Base displacements (actuator, time) as fractions of full scale, and the weights (tone,) that they are made of.

    weight: None for a waveform that is of no weights. achieved: whether both levels hold in the trimmed plants.
    bound_db: upper bound over all aims tried; gap_db: distance to it.
    """

    waveform: Array
    weight: Array | None
    achieved: bool
    bound_db: float
    gap_db: float


@dataclass(frozen=True)
class Trimmed:
    """A limit of the program, its optimum, and the 95th percentile of the quiet level over the trimmed plants."""

    limit_db: float
    optimum: Optimum
    quiet_db: float


class Designer:
    """Designs the click of one placement and length."""

    def __init__(
        self, device: Device, options: ClickOptions, plants: Plants, placement: Placement, length_s: float
    ) -> None:
        self._options, self._length_s, self._plants = options, length_s, plants
        self.felt, self.quiet = placement.felt, placement.quiet
        self.basis_set = click_set(device, length_s, options.crowding)
        self._tones = tones_of(self.basis_set)
        self._amplitude = device.limits.amplitude
        self._program: Program | None = None

    @property
    def effort(self) -> Effort:
        """What the programs of this design have taken so far."""
        return Effort() if self._program is None else self._program.effort

    @cached_property
    def search(self) -> Search:
        """The search over the optimised plants, made on first use: `fit` needs none."""
        watched = self._watched()
        drive = drive_rows(self._tones, self._amplitude, self._options.slew_per_s)
        program = self._program = Program(drive, watched, len(self.felt))
        course = self._plants.optimised.under(self.felt).mean().play_each(self._tones)[0]
        search = Search(program, course, self._length_s, self._options.search_gain)
        if watched.shape[0]:
            program.add(_first_rows(watched))
        return search

    def waveform(self, weight: Array) -> Array:
        """Base displacements (actuator, time) of weights (tone,)."""
        return self._tones.waveform(weight)

    def design(self) -> Design:
        """The strongest click within the quiet level, or one of the wanted level."""
        limit_db = self._options.quiet_db
        if not self.quiet:
            return self._settle(Trimmed(limit_db, self.search.strongest(_factor(limit_db)).optimum, limit_db))
        limit_db += _FIRST_LIMIT_DB
        return self._settle(self._trim(self.search.strongest(_factor(limit_db)), limit_db))

    def fit(self, waveform: Array) -> Design:
        """Any waveform, scaled to the limits, the quiet level and the wanted level; it has no bound (infinite)."""
        full = waveform * (self._amplitude / np.abs(waveform).max())
        if self.quiet:
            full *= _factor(min(0.0, self._options.quiet_db - self._strongest_db(self._plants.trimmed, full)))
        return self._as_wanted(full, np.inf, np.inf)

    def least_violation(self) -> Design | None:
        """The click with the least excess of the quiet level that reaches the wanted level; it has no bound.

        None where the amplitude of the actuators does not reach the wanted level at all.
        """
        wanted_db = self._options.wanted_db
        aim = self.search.strongest(_factor(self._options.quiet_db)).aim
        assert wanted_db is not None  # without a wanted level every click is achieved
        low_db, high_db = self._options.quiet_db, self._options.quiet_db + _MOST_EXCESS_DB
        for _ in range(_HALVINGS):
            middle_db = (low_db + high_db) / 2
            reached = self._felt_db(self.waveform(self._best_for(aim, middle_db))) >= wanted_db
            low_db, high_db = (low_db, middle_db) if reached else (middle_db, high_db)
        weight = self._best_for(aim, high_db)
        spare_db = self._felt_db(self.waveform(weight)) - wanted_db
        if spare_db < 0:
            return None
        weight = weight * _factor(-spare_db)
        return Design(self.waveform(weight), weight, achieved=False, bound_db=np.inf, gap_db=np.inf)

    def _watched(self) -> WatchedCourses:
        """Time courses that are limited: quiet fingers from the start, felt ones from the brake on if there is one."""
        optimised = self._plants.optimised
        fingers, start = list(self.quiet), [0] * len(self.quiet)
        if self._options.brake_s is not None:
            fingers += self.felt
            start += [round(self._options.brake_s * SAMPLE_RATE_HZ)] * len(self.felt)
        starts = np.tile(np.array(start, dtype=np.int64), len(optimised.transfer))
        return WatchedCourses(optimised.under(fingers), self._tones, starts)

    def _best_for(self, aim: Aim, limit_db: float) -> Array:
        return self.search.improve(aim, _factor(limit_db)).weight

    def _trim(self, found: Found, limit_db: float) -> Trimmed:
        """Move the limit until 95 % of the trimmed plants stay below the quiet level: first on few plants, then on all.

        After all plants were played once, only those near the percentile are played again.
        """
        trimmed, optimum = self._plants.trimmed, found.optimum
        few = self._quiet_db(trimmed.first(_ROUGHLY), optimum)
        over_db = _percentile(few, 95) - self._options.quiet_db
        if abs(over_db) >= _ROUGH_DB:
            limit_db -= over_db
            if abs(over_db) >= _SEARCH_AGAIN_DB:
                found = self.search.strongest(_factor(limit_db))
                optimum = found.optimum
            else:
                optimum = self.search.improve(found.aim, _factor(limit_db))
        every_db = self._quiet_db(trimmed, optimum)
        over_db = _percentile(every_db, 95) - self._options.quiet_db
        near = np.flatnonzero(np.abs(every_db - self._options.quiet_db - over_db) < _NEAR_DB)
        close_to = Responses(trimmed.transfer[1:][near], trimmed.lines)
        for _ in range(_TRIMS):
            if abs(over_db) < _CLOSE_DB:
                break
            limit_db -= over_db
            optimum = self.search.improve(found.aim, _factor(limit_db))
            every_db[near] = decibels(close_to.peaks(self.waveform(optimum.weight), self.quiet).max(axis=1))
            over_db = _percentile(every_db, 95) - self._options.quiet_db
        return Trimmed(limit_db, optimum, self._options.quiet_db + over_db)

    def _quiet_db(self, plants: Responses, optimum: Optimum) -> Array:
        """Level of the strongest quiet finger in every sampled plant (plant,)."""
        return decibels(plants.peaks(self.waveform(optimum.weight), self.quiet)[1:].max(axis=1))

    def _settle(self, trimmed: Trimmed) -> Design:
        """Scale down to the quiet level; the bound is that of the search at the trimmed limit."""
        optimum, limit = trimmed.optimum, _factor(trimmed.limit_db)
        change_db = min(0.0, self._options.quiet_db - trimmed.quiet_db)
        bound_db = float(decibels(max(self.search.bound(limit), optimum.bound.at(limit))))
        gap_db = bound_db - float(decibels(optimum.value)) - change_db
        weight = optimum.weight * _factor(change_db)
        return self._as_wanted(self.waveform(weight), bound_db, gap_db, weight)

    def _as_wanted(self, waveform: Array, bound_db: float, gap_db: float, weight: Array | None = None) -> Design:
        wanted_db = self._options.wanted_db
        if wanted_db is None:
            return Design(waveform, weight, True, bound_db, gap_db)
        felt_db = self._felt_db(waveform)
        softer = _factor(min(0.0, wanted_db - felt_db))
        scaled = None if weight is None else weight * softer
        return Design(waveform * softer, scaled, felt_db >= wanted_db, bound_db, gap_db)

    def _felt_db(self, waveform: Array) -> float:
        """5th percentile of the weakest felt finger over the trimmed plants, dB."""
        peak = self._plants.trimmed.peaks(waveform, self.felt)[1:]
        return _percentile(decibels(peak.min(axis=1)), 5)

    def _strongest_db(self, plants: Responses, waveform: Array) -> float:
        """95th percentile of the strongest quiet finger over the plants, dB."""
        peak = plants.peaks(waveform, self.quiet)[1:]
        return _percentile(decibels(peak.max(axis=1)), 95)


def _first_rows(watched: WatchedCourses) -> NDArray[np.int64]:
    """Watched rows that the pool starts with: every other sample of the first 70 ms in the first plants."""
    scenarios, fingers = watched.responses.transfer.shape[:2]
    course = np.arange(min(scenarios, _FIRST_PLANTS) * fingers)[:, None]
    sample = np.arange(0, round(_FIRST_S * SAMPLE_RATE_HZ), 2)
    numbers: NDArray[np.int64] = (course * watched.shape[1] + sample)[watched.start[course[:, 0], None] <= sample]
    return numbers


def _percentile(level_db: Array, percent: float) -> float:
    return float(np.percentile(level_db, percent))


def drive_rows(tones: Tones, amplitude: float, slew_per_s: float | None) -> Array:
    """Rows (row, tone) whose magnitude is at most 1 where displacements keep to the amplitude and the slew."""
    actuators: Sequence[int] = np.unique(tones.actuator).tolist()
    rows = list[Array]()
    for actuator in actuators:
        wave = (tones.wave * (tones.actuator == actuator)[:, None]).T
        rows.append(wave[1:-1] / amplitude)  # the window is 0 at both ends
        if slew_per_s is not None:
            rows.append(np.diff(wave, axis=0) * SAMPLE_RATE_HZ / slew_per_s)
    return np.concatenate(rows)


def _factor(level_db: float) -> float:
    return float(10 ** (level_db / 20))
