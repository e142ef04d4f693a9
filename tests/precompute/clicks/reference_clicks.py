"""Clicks by HiGHS on state-space plants: what the fast solver is measured against, and the judge of its programs.

It is the solver that the project had before, kept as it was where that decides speed and result: HiGHS on the rows
generated so far, which goes on from its last basis, and trimming that plays all plants each time. Tones, search and
evaluation are those of precompute.clicks.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import highspy
import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.touch import Placement
from precompute.clicks.basis import EVALUATIONS_PER_SAMPLE, make_tones, orthogonalised
from precompute.clicks.design import drive_rows
from precompute.clicks.evaluation import decibels
from precompute.clicks.options import ClickOptions
from precompute.clicks.program import TOLERANCE, UNBOUNDED, Basis, Bound, Optimum
from precompute.clicks.search import Search
from precompute.clicks.solver import FULL_SCALE
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.sampling.plants import sample_scenarios
from tests.precompute.clicks.reference_plants import MODES, TimeDomainResponses, sample_response

Array = NDArray[np.float64]

_PEAKS, _ROUNDS = 4, 60
_OVER, _NEAR, _WORTH_PURGING = 1e-9, 0.6, 100
_ROUGH_DB, _CLOSE_DB, _ROUGHLY, _TRIMS = 0.3, 0.05, 201, 3


class HighsProgram:
    """The program of precompute.clicks.program by HiGHS: rows enter as they are violated, and serve the next aim.

    drive (row, tone); watched (course, time, tone).
    """

    def __init__(self, drive: Array, watched: Array, aims: int) -> None:
        self._drive, self._aims, self._tones = drive, aims, drive.shape[1]
        self._rows = watched.reshape(-1, watched.shape[-1])
        self._entered, self._order = np.zeros(watched.shape[:2], np.bool_), np.zeros(0, np.int64)
        self._limit = 1.0
        self._columns = np.arange(self._tones + 1, dtype=np.int32)  # the last is what all aims exceed
        endless = np.full(self._tones + 1, highspy.kHighsInf)
        self._solver: Any = highspy.Highs()  # type: ignore[no-untyped-call]  # highspy has stubs for part of itself
        for option, value in (("output_flag", False), ("presolve", "off"), ("threads", 1)):
            self._solver.setOptionValue(option, value)
        self._solver.addVars(self._tones + 1, -endless, endless)
        self._solver.changeObjectiveSense(highspy.ObjSense.kMaximize)
        self._solver.changeColCost(self._tones, float(aims > 1))
        if aims > 1:
            self._add(np.column_stack([np.zeros((aims, self._tones)), -np.ones(aims)]), 0.0, highspy.kHighsInf)
        else:
            self._solver.changeColBounds(self._tones, 0.0, 0.0)
        self._first_drive = aims if aims > 1 else 0
        self._first_watched = self._first_drive + len(drive)
        self._add_limits(drive, 1.0)

    def set_limit(self, limit: float) -> None:
        """Change the limit of the watched courses."""
        self._limit = limit
        rows = np.arange(self._first_watched, self._first_watched + len(self._order), dtype=np.int32)
        self._solver.changeRowsBounds(len(rows), rows, np.full(len(rows), -limit), np.full(len(rows), limit))

    def maximise(
        self,
        aims: Array,
        floor: float = 0.0,
        tolerance: float = TOLERANCE,
        start: Basis | None = None,  # noqa: ARG002  # HiGHS goes on from its own last basis
    ) -> Optimum:
        """The best weights for aims (aim, tone), to `tolerance` relative; given up once the bound is below `floor`."""
        self._purge()
        if self._aims == 1:
            self._solver.changeColsCost(self._tones, self._columns[:-1], aims[0])
        else:
            for (aim, tone), coefficient in np.ndenumerate(aims):
                self._solver.changeCoeff(aim, tone, coefficient)
        best = Optimum(np.zeros(self._tones), 0.0, UNBOUNDED)
        for _ in range(_ROUNDS):
            weight, bound = self._solve()
            course = np.abs(self._rows @ weight).reshape(self._entered.shape)
            worst = max(1.0, float(course.max(initial=0.0)) / self._limit, float(np.abs(self._drive @ weight).max()))
            value = float((aims @ weight).min()) / worst
            best = Optimum(weight / worst, value, bound) if value >= best.value else replace(best, bound=bound)
            least = bound.at(self._limit)
            if best.value >= least * (1 - tolerance) or least <= floor or not self._add_violated(course):
                break
        return best

    def _solve(self) -> tuple[Array, Bound]:
        self._solver.run()
        if self._solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            self._solver.clearSolver()  # its last basis was too ill-conditioned: from the start
            self._solver.run()
        solution = self._solver.getSolution()
        price = np.abs(solution.row_dual)
        drive, watched = price[self._first_drive : self._first_watched], price[self._first_watched :]
        return np.array(solution.col_value)[:-1], Bound(float(drive.sum()), float(watched.sum()))

    def _add_violated(self, course: Array) -> bool:
        peak = (course > self._limit * (1 + _OVER)) & ~self._entered
        peak[:, 1:] &= course[:, 1:] >= course[:, :-1]
        peak[:, :-1] &= course[:, :-1] >= course[:, 1:]
        found = list[NDArray[np.int64]]()
        for index in np.flatnonzero(peak.any(axis=1)).tolist():
            times = np.flatnonzero(peak[index])
            found.append(index * course.shape[1] + times[np.argsort(course[index, times])[-_PEAKS:]])
        if found:
            new = np.concatenate(found)
            self._order = np.concatenate([self._order, new])
            self._entered.flat[new] = True
            self._add_limits(self._rows[new], self._limit)
        return bool(found)

    def _purge(self) -> None:
        if not len(self._order):
            return
        reached = np.abs(self._solver.getSolution().row_value)[self._first_watched :]
        idle = np.ones(len(self._order), np.bool_)
        idle[: len(reached)] = reached < _NEAR * self._limit
        if np.count_nonzero(idle) >= _WORTH_PURGING:
            self._entered.flat[self._order[idle]] = False
            self._order = self._order[~idle]
            rows = (self._first_watched + np.flatnonzero(idle)).astype(np.int32)
            self._solver.deleteRows(len(rows), rows)

    def _add_limits(self, rows: Array, limit: float) -> None:
        self._add(np.column_stack([rows, np.zeros(len(rows))]), -limit, limit)

    def _add(self, rows: Array, low: float, high: float) -> None:
        count, size = rows.shape
        starts, columns = np.arange(0, rows.size, size, dtype=np.int32), np.tile(self._columns, count)
        values = np.ascontiguousarray(rows.ravel())
        self._solver.addRows(count, np.full(count, low), np.full(count, high), rows.size, starts, columns, values)


class ReferenceSolver:
    """Strongest clicks of one device by HiGHS on state-space plants, of the first length of the options."""

    def __init__(self, device: Device, options: ClickOptions) -> None:
        self.device, self.options = device, options
        counts = (options.scenarios, options.trimmed, options.judged)
        seeds = np.random.SeedSequence(options.seed).generate_state(len(counts)).tolist()
        self._scenarios = [sample_scenarios(device, *each) for each in zip(counts, seeds, strict=True)]
        self._bases = [
            [compute_basis(assemble(scenarios.device_of(s)), MODES) for s in range(len(scenarios))]
            for scenarios in self._scenarios
        ]
        self.plants_of = lru_cache(maxsize=1)(self._compute_plants)
        """Responses of the plants to optimise over, to trim on and to evaluate with, fingers at these positions."""

    def solve(self, placement: Placement) -> Array:
        """Waveform (actuator, time) of the strongest click, rounded to the samples of the wire."""
        options, (optimised, trimmed, _) = self.options, self.plants_of(placement.position_m)
        length_s, felt, quiet = options.lengths_s[0], placement.felt, placement.quiet
        tones = orthogonalised(make_tones(self.device, length_s, options.crowding))
        watched = optimised.under(quiet).play_each(tones, EVALUATIONS_PER_SAMPLE)
        drive = drive_rows(tones, self.device.limits.amplitude, options.slew_per_s)
        program = HighsProgram(drive, watched.reshape(-1, *watched.shape[2:]), len(felt))
        course = optimised.under(felt).mean().play_each(tones)[0]
        search = Search(program, course, length_s, options.search_gain)
        limit_db = over_db = options.quiet_db
        found = search.strongest(10 ** (limit_db / 20))
        if not quiet:
            return _rounded(tones.waveform(found.optimum.weight))
        for plants, close_db in ((trimmed.first(_ROUGHLY), _ROUGH_DB), (trimmed, _CLOSE_DB)):
            optimum = found.optimum
            for trim in range(_TRIMS + 1):
                level_db = decibels(plants.peaks(tones.waveform(optimum.weight), quiet)[1:].max(axis=1))
                over_db = float(np.percentile(level_db, 95)) - options.quiet_db
                if abs(over_db) < close_db or trim == _TRIMS:
                    break
                limit_db -= over_db
                optimum = search.improve(found.aim, 10 ** (limit_db / 20))
            if plants is not trimmed:
                found = search.strongest(10 ** (limit_db / 20))
        return _rounded(tones.waveform(optimum.weight) * 10 ** (min(0.0, -over_db) / 20))

    def _compute_plants(self, position_m: tuple[float, ...]) -> list[TimeDomainResponses]:
        plants, longest_s = [], max(self.options.lengths_s)
        for scenarios, bases in zip(self._scenarios, self._bases, strict=True):
            placed = scenarios.place(position_m, self.options.tolerance_m)
            courses = [sample_response(basis, placed.of(s), longest_s) for s, basis in enumerate(bases)]
            plants.append(TimeDomainResponses.of(np.array(courses), longest_s, scenarios.device.threshold))
        return plants


def _rounded(waveform: Array) -> Array:
    return np.trunc(waveform * FULL_SCALE) / FULL_SCALE
