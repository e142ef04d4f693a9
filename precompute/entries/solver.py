"""Solver of entries: the best drive for a state of the fingers at every level, with all its figures."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.table import Entry
from engine.touch import ZoneState, state_index
from precompute.entries.found_drive import FoundDrive
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES, Problem, level
from precompute.entries.prediction import Candidate, MadeFor, States, make_entry, touched_zones
from precompute.entries.search import Found, Search, polish, start_at
from precompute.model.assembly import Plant
from precompute.model.frequencies import add_resonances
from precompute.model.modal import compute_basis, count_modes
from precompute.parallel.pool import WorkerPool
from precompute.predict.forms import Forms, compute_forms
from precompute.predict.performance import compute_figures
from precompute.predict.rise_time import RiseModel, compute_rise_model, compute_rise_time
from precompute.sampling.bars import sample_bars
from precompute.sampling.fingers import sample_fingers
from precompute.sampling.receptance import solve_receptance

Array = NDArray[np.float64]

MOST_TABULATED_ZONES = 8
"""A table of a bar with at most this many zones holds every state: 3^8 are 6561."""
MOST_TOUCHED_BEYOND = 3
"""On a bar with more zones a table holds the states of at most this many fingers; others are solved on demand."""
_CHUNK = 8  # states that a process takes at a time: 0.5 s
_NEARLY_CONVERGED = 10 ** (0.1 / 20) - 1  # 0.1 dB: enough modes for the range of rise times


def tabulated_states(device: Device) -> list[States]:
    """Every state with a felt zone that a table of the device holds, in the order of their numbers."""
    count = len(device.zones)
    most = count if count <= MOST_TABULATED_ZONES else MOST_TOUCHED_BEYOND
    found = list[States]()
    for touched in range(1, most + 1):
        for zones in itertools.combinations(range(count), touched):
            for kinds in itertools.product((ZoneState.QUIET, ZoneState.FELT), repeat=touched):
                if ZoneState.FELT in kinds:
                    state = dict(zip(zones, kinds, strict=True))
                    found.append(tuple(state.get(zone, ZoneState.FREE) for zone in range(count)))
    return sorted(found, key=state_index)


def solve_entries(
    plant: Plant, objective: str = DEFAULT_OBJECTIVE, pool: WorkerPool | None = None, made_for: MadeFor = MadeFor.MEAN
) -> Iterator[tuple[list[Entry], float]]:
    """The entries of every tabulated state, one a level, with the fraction done; by this process and its workers."""
    chunks = _chunks(tabulated_states(plant.device))
    count, begin = sum(map(len, chunks)), partial(_begin, plant, objective, made_for)
    solved = (pool or WorkerPool(0)).solve(begin, chunks, include_self=True)
    for done, entries in enumerate(solved, 1):
        yield entries, done / count


def _chunks(states: Sequence[States]) -> list[list[States]]:
    """States with the same fingers together, so that they share what is computed for them; most fingers first."""
    same = itertools.groupby(sorted(states, key=_most_fingers), key=touched_zones)
    groups = [list(group) for _, group in same]
    return [group[start : start + _CHUNK] for group in groups for start in range(0, len(group), _CHUNK)]


def _most_fingers(states: States) -> tuple[int, tuple[int, ...]]:
    touched = touched_zones(states)
    return -len(touched), touched


def _begin(plant: Plant, objective: str, made_for: MadeFor) -> Callable[[States], list[Entry]]:
    return EntrySolver(plant, objective, made_for).solve


def prepare_entries() -> None:
    """Does nothing. A worker that unpickles it has imported what entries are solved with, before there is a plant."""


class EntrySolver:
    """Solves states of one plant; what states with the same fingers share is computed once.

    `objective`: a name of precompute.entries.objective.OBJECTIVES.
    """

    def __init__(self, plant: Plant, objective: str = DEFAULT_OBJECTIVE, made_for: MadeFor = MadeFor.MEAN) -> None:
        self.plant, self.device, self.made_for = plant, plant.device, made_for
        self.sampled = sample_fingers(plant.device)
        # Measured responses belong to one bar: no others are sampled.
        self.bars = None if plant.is_measured else sample_bars(plant.device, self.sampled)
        self.forms_of = lru_cache(maxsize=2)(self._compute_forms)
        """Forms with a finger in each of some zones (indices, a tuple), at every frequency of the search."""
        self._objective = OBJECTIVES[objective]
        self._basis = compute_basis(plant)
        band_hz = (self.device.sweep.start_hz, self.device.sweep.stop_hz)
        self._few_modes = self._basis.lowest(count_modes(self._basis, _NEARLY_CONVERGED, band_hz))
        self._rise_of = lru_cache(maxsize=2)(self._compute_rise)
        self.frequency_hz = self._search_frequencies()
        """Frequencies of the search (frequency,)."""
        self._receptance = solve_receptance(plant, self.sampled, self.frequency_hz)

    def solve(self, states: States) -> list[Entry]:
        """The entry of one state for each level of the device, then for full scale."""
        forms, levels_db = self.forms_of(touched_zones(states)), self.device.levels_db
        wanted = [self.wanted_power(level_db) for level_db in levels_db]
        loud = Search(level(forms, states), [])
        loudest = loud.best(0.0)
        assert loudest is not None  # with nothing wanted there is always a drive
        problem = self._objective(forms, states)
        full = self._pick(loudest, states, level, "level", 0.0)
        if self.made_for is MadeFor.WORST:
            return self._solve_for_worst(states, problem, full, loudest, loud)
        found = _find_above(problem, wanted, loudest, loud)
        # One drive may serve several levels: it is polished for the highest.
        highest = {id(each): power for each, power in zip(found, wanted, strict=True)}
        chosen = {
            id(each): self._pick(each, states, self._objective, problem.name, highest[id(each)])
            for each in found
            if each is not None
        }
        candidates = [*(chosen.get(id(each), full) for each in found), full]
        return [
            make_entry(self.device, candidate, level_db)
            for candidate, level_db in zip(candidates, (*levels_db, np.inf), strict=True)
        ]

    def _solve_for_worst(
        self, states: States, problem: Problem, full: Candidate, loudest: Found, loud: Search
    ) -> list[Entry]:
        """Entries by their figure in all but the worst 5 % of the sampled cases, of all drives that the search meets.

        It is found for the mean, also above the levels that leave to the mean what the worst cases lack; so it is no
        optimum, and claims no bound.
        """
        lacking = 10 ** ((full.full_level_db - full.low_level_db) / 10)
        wanted = [self.wanted_power(level_db) for level_db in self.device.levels_db]
        powers = sorted({*wanted, *(power * lacking for power in wanted)})
        found = zip(_find_above(problem, powers, loudest, loud), powers, strict=True)
        drives = [
            self._exact(drive, states, self._objective, power)
            for each, power in found
            if each is not None
            for drive in (each.drive, *each.ties)
        ]
        pool = [replace(full, bound=np.inf)]
        pool += [self._with_figures(states, problem.name, drive, np.inf, self._rise(states, drive)) for drive in drives]
        loudest_candidate = max(pool, key=lambda candidate: candidate.low_level_db)
        entries = list[Entry]()
        for level_db in (*self.device.levels_db, np.inf):
            loud_enough = [candidate for candidate in pool if candidate.low_level_db >= level_db]
            candidate = max(loud_enough, key=lambda candidate: candidate.low_merit, default=loudest_candidate)
            entries.append(make_entry(self.device, candidate, level_db, self.made_for))
        return entries

    def evaluate(self, states: States, wanted_level_db: float, drive: FoundDrive, name: str) -> Entry:
        """The entry of any drive in a state. It claims no optimum: its gap is infinite."""
        candidate = self._with_figures(states, name, drive, np.inf, self._rise(states, drive))
        return make_entry(self.device, candidate, wanted_level_db)

    def wanted_power(self, level_db: float) -> float:
        """Power over threshold that a drive needs at amplitude 1 to have `level_db` at the amplitude limit."""
        return float(10 ** (level_db / 10) / self.device.limits.amplitude**2)

    def _limited(self, drive: FoundDrive) -> NDArray[np.complex128]:
        limited: NDArray[np.complex128] = drive.amplitude * self.device.limits.amplitude
        return limited

    def _search_frequencies(self) -> Array:
        """The grid of the device, with the resonances of the bar untouched, under all fingers and under each alone."""
        finger, middles = self.device.finger, self.sampled.middle_m.tolist()
        loads = [[], [(at, finger) for at in middles], *([(at, finger)] for at in middles)]
        pole = compute_rise_model(self._few_modes, loads, np.zeros((len(loads), 0))).pole.ravel()
        return add_resonances(self.device, self.device.sweep.frequency_hz, pole)

    def _compute_forms(self, touched: tuple[int, ...]) -> Forms:
        return compute_forms(self._receptance, touched)

    def _compute_rise(self, touched: tuple[int, ...]) -> tuple[RiseModel, RiseModel]:
        """Models of the standard case, with all modes, and of every case, with the lower ones."""
        loads = [self.sampled.fingers(case, touched) for case in range(len(self.sampled.place))]
        places_m = np.array([[at for at, _ in load] for load in loads])
        standard = compute_rise_model(self._basis, loads[:1], places_m[:1])
        return standard, compute_rise_model(self._few_modes, loads, places_m)

    def _pick(
        self, found: Found, states: States, make: Callable[[Forms, States], Problem], objective: str, wanted: float
    ) -> Candidate:
        """The drive of the shortest rise among the ties, climbed on exact forms, with all its figures."""
        drives = [self._exact(drive, states, make, wanted) for drive in (found.drive, *found.ties)]
        timed = [(drive, self._rise(states, drive)) for drive in drives]
        drive, rise_s = min(timed, key=lambda pair: (pair[1][0], -pair[0].loudness))
        return self._with_figures(states, objective, drive, found.bound, rise_s)

    def _with_figures(
        self, states: States, objective: str, drive: FoundDrive, bound: float, rise_s: Array
    ) -> Candidate:
        touched, amplitude = touched_zones(states), self._limited(drive)
        figures = compute_figures(self.plant, self.sampled, touched, drive.frequency_hz, amplitude)
        bars = self.bars
        sampled = figures.power[1:] if bars is None else bars.powers(touched, drive.frequency_hz, amplitude)
        return Candidate(states, objective, drive, bound, figures, rise_s, sampled)

    def _exact(
        self, drive: FoundDrive, states: States, make: Callable[[Forms, States], Problem], wanted: float
    ) -> FoundDrive:
        """Climb the drive on the plant solved at its own frequencies, between which the search interpolates."""
        tones = np.unique(drive.frequency_hz[drive.amplitude != 0])
        forms = compute_forms(solve_receptance(self.plant, self.sampled, tones), touched_zones(states))
        moved = replace(drive, frequency_hz=np.where(drive.amplitude == 0, tones[0], drive.frequency_hz))
        return polish(make(forms, states), moved, wanted)

    def _rise(self, states: States, drive: FoundDrive) -> Array:
        """Rise time of the slowest felt finger (case,), the standard case first."""
        touched = touched_zones(states)
        felt = [finger for finger, zone in enumerate(touched) if states[zone] is ZoneState.FELT]
        exact, few_modes = self._rise_of(touched)
        standard = compute_rise_time(exact, drive.frequency_hz, drive.amplitude)
        sampled = compute_rise_time(few_modes, drive.frequency_hz, drive.amplitude)
        slowest: Array = np.concatenate([standard, sampled[1:]])[:, felt].max(axis=1)
        return slowest


def _find_above(problem: Problem, wanted: Sequence[float], loudest: Found, loud: Search) -> list[Found | None]:
    """The best drive above each wanted power, in rising order; None where no drive reaches it."""
    return _flat(loud.basins(), wanted) if problem.is_flat else _above_levels(problem, wanted, loudest, loud)


def _above_levels(problem: Problem, wanted: Sequence[float], loudest: Found, loud: Search) -> list[Found | None]:
    """The best drive above each wanted power, in rising order; None beyond the loudest drive, which `loud` found."""
    search = Search(problem, wanted)
    found = list[Found | None]()
    for power in wanted:
        last = found[-1] if found else None
        if last is not None and last.drive.loudness >= power:
            found.append(last)
        elif power <= loudest.drive.loudness:
            found.append(search.best(power, [start_at(loudest.drive), *loud.edges(power)]))
        else:
            found.append(None)
    return found


def _flat(loud: Sequence[FoundDrive], wanted: Sequence[float]) -> list[Found | None]:
    """Where all drives have the same share, as with all zones felt: those that are loud enough, as ties."""
    found = list[Found | None]()
    for power in wanted:
        enough = [replace(drive, value=1.0) for drive in loud if drive.loudness >= power]
        found.append(Found(enough[0], tuple(enough[1:]), 1.0) if enough else None)
    return found
