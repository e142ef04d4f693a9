"""Responses to the best drive of every zone combination: the global optimum of the localized factor above a floor.

Three families (PHYSICS.md section 3). Single tone: one actuator. Two tones: two actuators at two frequencies; a
weighted mean of two single tones, so it matters only where the level floor rules the better one out. Coherent: all
actuators at one frequency with phase; its optimum without a floor is the largest eigenvalue of R_S a = lambda T a and
bounds every drive of every family. With a floor, coarse search over the whole grid is followed by a narrowing search:
global for two actuators as far as tests could tell (0.002), for more within what the bound leaves open.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from precompute.assembly import Plant
from precompute.directions import (
    CoherentFigures,
    compute_coherent_figures,
    full_scale,
    pair_directions,
    random_directions,
)
from precompute.grid import GridResponse, compute_grid_response
from precompute.sweep import fill_lift, fold_amplitudes

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FREQUENCY_STEP_HZ = 0.01
"""Resolution of frequency on the wire."""
BEAT_HZ = 10.0
"""Two tones closer than this beat within a touch (PHYSICS.md section 2)."""
_SEARCH_RATIOS, _SEARCH_PHASES = 8, 48
_ROUNDS, _TRIES, _LINE, _SHRINK = 11, 127, 5, 0.5
_MANY_ROUNDS, _MANY_SHRINK, _MANY_BASINS, _MANY_TRIES = (
    30,
    0.8,
    12,
    511,
)  # more than two actuators: more directions to get lost in
_BASINS = 3
_LINE_ROUNDS = 2  # 33 points twice: from 2 Hz to 4 mHz, under the wire's step
_MANY_GAIN = 0.05
_BASIN_GAIN = 0.01  # more than narrowing adds to the best of a basin on the search grid
_TIE = 1e-6
_NEAR = 1e-3  # what narrowing can add to a single tone found on the grid
_FLOOR_SLACK = 1e-6


@dataclass(frozen=True)
class Candidate:
    """A drive: frequency_hz (actuator,), amplitude (actuator,) complex fractions of the amplitude limit."""

    family: str
    frequency_hz: Array
    amplitude: Complex
    localized_factor: float
    achieved: bool


@dataclass(frozen=True)
class Optimum:
    """Best drive of a zone combination, and a bound that no drive can pass."""

    best: Candidate
    upper_bound: float


class Optimizer:
    """Searches one plant; everything that does not depend on the zone combination is computed once."""

    def __init__(self, plant: Plant, grid: GridResponse) -> None:
        self.plant, self.grid = plant, grid
        limits = plant.device.limits
        self.floor = limits.level_floor_m_per_s2 / limits.amplitude * (1 + _FLOOR_SLACK)
        self.count = len(plant.device.actuators)
        self.directions = _search_directions(self.count)
        self.figures = compute_coherent_figures(grid, self.directions)

    def solve(self, zones: Sequence[int]) -> Optimum:
        """The best drive for `zones` (indices) together; where they are the whole bar, the loudest."""
        wanted = list(zones)
        if len(wanted) == len(self.plant.device.zones) and _cover(self.grid, wanted):
            return Optimum(self._loudest(wanted), 1.0)
        coherent, bound = self._coherent(wanted)
        best = coherent
        for other in (*self._single(wanted, coherent), *self._two_tones(wanted, coherent)):
            if best is None or other.localized_factor >= best.localized_factor - _TIE:
                best = other
        if best is None:
            return Optimum(self._loudest(wanted), bound)
        return Optimum(best, max(bound, best.localized_factor))

    # --- single tone

    def _single(self, wanted: list[int], rival: Candidate | None) -> Iterator[Candidate]:
        """Best frequency of each actuator alone, where it comes near the rival: it is the simpler drive."""
        least = -1.0 if rival is None else rival.localized_factor - _NEAR
        for actuator in range(self.count):
            factor = _single_factor(self.grid, wanted, actuator, self.floor)
            for k in _peaks(factor)[:1]:
                if factor[k] >= max(least, 0):
                    frequency_hz, value = self._narrow_single(wanted, actuator, k)
                    amplitude = np.zeros(self.count, dtype=np.complex128)
                    amplitude[actuator] = 1
                    yield Candidate("single tone", np.full(self.count, frequency_hz), amplitude, value, True)

    def _narrow_single(self, wanted: list[int], actuator: int, k: int) -> tuple[float, float]:
        line_hz, value = self.grid.frequency_hz, -1.0
        for _ in range(_LINE_ROUNDS):
            line = self._solve_line(_around(line_hz, k))
            line_hz, factor = line.frequency_hz, _single_factor(line, wanted, actuator, self.floor)
            k = int(factor.argmax())
            value = float(factor[k])
        return float(line_hz[k]), value

    # --- coherent

    def _coherent(self, wanted: list[int]) -> tuple[Candidate | None, float]:
        """Best direction and frequency, and the unconstrained eigenvalue bound."""
        eigen = _largest_eigenvalue(self.grid, wanted)
        bound_hz, bound, direction = self._narrow_eigen(wanted, int(eigen.argmax()))
        there = compute_coherent_figures(self._solve_line(np.array([bound_hz])), direction[:, None])
        if there.allowed[0, 0] and there.peak[0, wanted, 0].min() >= self.floor:
            return self._candidate("coherent", bound_hz, direction, bound), bound
        score = _feasible_factor(self.figures, wanted, self.floor)
        best: Candidate | None = None
        starts, gain = self._starts(score), _BASIN_GAIN if self.count <= 2 else _MANY_GAIN
        for k, d in starts:
            if best and score[k, d] < best.localized_factor - gain:
                break
            found = self._narrow_direction(wanted, k, self.directions[:, d])
            if best is None or found.localized_factor > best.localized_factor:
                best = found
        return best, bound

    def _starts(self, score: NDArray[np.float32]) -> list[tuple[int, int]]:
        """Where to narrow from: frequency and direction, the peaks over frequency, best first."""
        count = _BASINS if self.count <= 2 else _MANY_BASINS
        return [(k, int(score[k].argmax())) for k in _peaks(score.max(axis=1))[:count]]

    def _narrow_eigen(self, wanted: list[int], k: int) -> tuple[float, float, Complex]:
        line, eigen = self.grid, np.zeros(0)
        for _ in range(_LINE_ROUNDS):
            line = self._solve_line(_around(line.frequency_hz, k))
            eigen = _largest_eigenvalue(line, wanted)
            k = int(eigen.argmax())
        return float(line.frequency_hz[k]), float(eigen[k]), _eigen_direction(line, wanted, k)

    def _narrow_direction(self, wanted: list[int], k: int, start: Complex) -> Candidate:
        """Shrinking random search around a start, all tries of a round in one kernel call; never leaves the floor."""
        rng = np.random.default_rng(0)
        hz = self.grid.frequency_hz
        centre_hz, direction, value = float(hz[k]), start, -1.0
        width_hz = max(hz[min(k + 1, len(hz) - 1)] - hz[max(k - 1, 0)], 1e-3)
        spread = 0.3
        few = self.count <= 2
        rounds, shrink, count = (_ROUNDS, _SHRINK, _TRIES) if few else (_MANY_ROUNDS, _MANY_SHRINK, _MANY_TRIES)
        for _ in range(rounds):
            line = self._solve_line(np.clip(np.linspace(-1, 1, _LINE) * width_hz + centre_hz, hz[0], hz[-1]))
            noise = rng.normal(size=(2, self.count, count)) * spread * rng.choice([1.0, 0.3, 0.1], size=count)
            tries = full_scale(np.column_stack([direction, direction[:, None] + noise[0] + 1j * noise[1]]))
            score = _feasible_factor(compute_coherent_figures(line, tries), wanted, self.floor)
            f, d = np.unravel_index(score.argmax(), score.shape)
            if score[f, d] > value:
                centre_hz, direction, value = float(line.frequency_hz[f]), tries[:, d], float(score[f, d])
            width_hz, spread = width_hz * shrink, spread * shrink
        return self._candidate("coherent", centre_hz, direction, value)

    # --- two tones, and the last resort

    def _two_tones(self, wanted: list[int], rival: Candidate | None) -> Iterator[Candidate]:
        """For every ordered pair: the first at full scale, the second just loud enough to lift the wanted zones."""
        least = -1.0 if rival is None else rival.localized_factor
        for i in range(self.count):
            # A weighted mean beats the rival only if the first tone would, were there no floor.
            if _single_factor(self.grid, wanted, i, 0.0).max() > least:
                for j in range(self.count):
                    if i != j and (found := self._narrow_pair(wanted, i, j)):
                        yield found

    def _narrow_pair(self, wanted: list[int], i: int, j: int) -> Candidate | None:
        line_1, line_2, lift = self.grid, self.grid, self._lift[i, j]
        best: Candidate | None = None
        for _ in range(_LINE_ROUNDS + 1):
            amplitude = lift[:, :, wanted].max(axis=2)
            factor = _pair_factor(line_1, line_2, wanted, (i, j), amplitude)
            k, m = (int(n) for n in np.unravel_index(factor.argmax(), factor.shape))
            if factor[k, m] < 0:
                break
            frequency_hz, weights = (
                np.full(self.count, line_1.frequency_hz[k]),
                np.zeros(self.count, dtype=np.complex128),
            )
            frequency_hz[j], weights[i], weights[j] = line_2.frequency_hz[m], 1, amplitude[k, m]
            best = Candidate("two tones", frequency_hz, weights, float(factor[k, m]), True)
            line_1, line_2 = (self._solve_line(_around(line.frequency_hz, n)) for line, n in ((line_1, k), (line_2, m)))
            lift = _compute_lift(line_1, line_2, (i, j), self.floor)
        return best

    @cached_property
    def _lift(self) -> dict[tuple[int, int], NDArray[np.float32]]:
        """For every ordered pair of actuators: least second amplitude (frequency_1, frequency_2, zone)."""
        pairs = [(i, j) for i in range(self.count) for j in range(self.count) if i != j]
        return {pair: _compute_lift(self.grid, self.grid, pair, self.floor) for pair in pairs}

    def _loudest(self, wanted: list[int]) -> Candidate:
        """The drive whose weakest wanted zone is loudest: all the same where the floor is met, the best where not."""
        weakest = np.where(self.figures.allowed, self.figures.peak[:, wanted].min(axis=1), -1)
        f, d = np.unravel_index(weakest.argmax(), weakest.shape)
        level, hz = float(weakest[f, d]), self.grid.frequency_hz
        value = float(self.figures.factor[f, wanted, d].sum())
        best = self._candidate("coherent", float(hz[f]), self.directions[:, d], value)
        for i, j in itertools.combinations(range(self.count), 2):
            both = _full_scale_level(self.grid, (i, j), wanted)
            k, m = np.unravel_index(both.argmax(), both.shape)
            if both[k, m] > level:
                frequency_hz, weights = np.full(self.count, hz[k]), np.zeros(self.count, dtype=np.complex128)
                frequency_hz[j], weights[i], weights[j] = hz[m], 1, 1
                level, best = float(both[k, m]), Candidate("two tones", frequency_hz, weights, 0.0, True)
        return replace(best, achieved=level >= self.floor)

    def _candidate(self, family: str, frequency_hz: float, direction: Complex, value: float) -> Candidate:
        driven = "single tone" if np.count_nonzero(direction) == 1 else family
        return Candidate(driven, np.full(self.count, frequency_hz), full_scale(direction[:, None])[:, 0], value, True)

    def _solve_line(self, frequency_hz: Array) -> GridResponse:
        """The plant at the frequencies that the wire carries next to these: what is found is what is played."""
        played_hz = np.unique(np.round(frequency_hz / FREQUENCY_STEP_HZ)) * FREQUENCY_STEP_HZ
        return compute_grid_response(self.plant, played_hz, self.grid.position_m)


def _cover(grid: GridResponse, wanted: list[int]) -> bool:
    """Whether the zones hold all of the bar's energy."""
    energy = np.einsum("zii->i", grid.gram[0, wanted]).real
    return bool(np.allclose(energy, np.einsum("ii->i", grid.total[0]).real, rtol=1e-9, atol=0.0))


def _search_directions(count: int) -> Complex:
    ratios = fold_amplitudes(_SEARCH_RATIOS)
    parts = [
        pair_directions(count, (i, j), ratios, _SEARCH_PHASES) for i in range(count) for j in range(i + 1, count)
    ] or [np.ones((1, 1), dtype=np.complex128)]
    if count > 2:
        parts.append(random_directions(count))
    return np.concatenate(parts, axis=1)


def _feasible_factor(figures: CoherentFigures, wanted: list[int], floor: float) -> NDArray[np.float32]:
    """Localized factor (frequency, direction) of the wanted zones, -1 where the floor or a band forbids it."""
    feasible = figures.allowed & (figures.peak[:, wanted].min(axis=1) >= floor)
    return np.where(feasible, figures.factor[:, wanted].sum(axis=1), np.float32(-1))


def _single_factor(grid: GridResponse, wanted: list[int], actuator: int, floor: float) -> Array:
    """Localized factor (frequency,) of one actuator alone, -1 where the floor or its band forbids it."""
    level = abs(grid.acceleration[:, actuator, wanted]).max(axis=2).min(axis=1)
    factor = grid.gram[:, wanted, actuator, actuator].real.sum(axis=1) / grid.total[:, actuator, actuator].real
    return np.where(grid.in_band[:, actuator] & (level >= floor), factor, -1)


def _compute_lift(
    line_1: GridResponse, line_2: GridResponse, pair: tuple[int, int], floor: float
) -> NDArray[np.float32]:
    first, second = (
        np.ascontiguousarray(abs(line.acceleration[:, actuator]), dtype=np.float32)
        for line, actuator in zip((line_1, line_2), pair, strict=True)
    )
    out = np.empty((len(first), len(second), first.shape[1]), dtype=np.float32)
    fill_lift(first, second, np.float32(floor), out)
    return out


def _pair_factor(
    line_1: GridResponse, line_2: GridResponse, wanted: list[int], pair: tuple[int, int], amplitude: NDArray[np.float32]
) -> Array:
    """Localized factor (frequency_1, frequency_2) of tone 1 at full scale and tone 2 at `amplitude`; -1: not usable."""
    i, j = pair
    power = amplitude.astype(np.float64) ** 2
    part_1, part_2 = (
        line.gram[:, wanted, a, a].real.sum(axis=1) for line, a in zip((line_1, line_2), pair, strict=True)
    )
    factor = (part_1[:, None] + power * part_2) / (
        line_1.total[:, i, i].real[:, None] + power * line_2.total[:, j, j].real
    )
    apart = abs(line_1.frequency_hz[:, None] - line_2.frequency_hz) >= BEAT_HZ
    usable = (amplitude <= 1) & line_1.in_band[:, i, None] & line_2.in_band[:, j] & apart
    return np.where(usable, factor, -1)


def _full_scale_level(grid: GridResponse, pair: tuple[int, int], wanted: list[int]) -> NDArray[np.float32]:
    """Peak of the weakest wanted zone (frequency_1, frequency_2), both tones at full scale; -1: not usable."""
    i, j = pair
    first, second = abs(grid.acceleration[:, i]).astype(np.float32), abs(grid.acceleration[:, j]).astype(np.float32)
    level = np.stack([(one[wanted] + second[:, wanted]).max(axis=2).min(axis=1) for one in first])
    apart = abs(grid.frequency_hz[:, None] - grid.frequency_hz) >= BEAT_HZ
    return np.where(grid.in_band[:, i, None] & grid.in_band[:, j] & apart, level, np.float32(-1))


def _around(line_hz: Array, k: int, count: int = 33) -> Array:
    """Frequencies between the neighbours of the k-th."""
    return np.linspace(line_hz[max(k - 1, 0)], line_hz[min(k + 1, len(line_hz) - 1)], count)


def _largest_eigenvalue(grid: GridResponse, wanted: list[int]) -> Array:
    """Shape (frequency,): the greatest lambda of R_S a = lambda T a over the actuators whose band holds f."""
    out = np.full(len(grid.frequency_hz), -1.0)
    part = grid.gram[:, wanted].sum(axis=1)
    for usable in np.unique(grid.in_band, axis=0):
        rows = np.flatnonzero((grid.in_band == usable).all(axis=1))
        if usable.any():
            pick = np.ix_(rows, np.flatnonzero(usable), np.flatnonzero(usable))
            lower = np.linalg.inv(np.linalg.cholesky(grid.total[pick]))
            out[rows] = np.linalg.eigvalsh(lower @ part[pick] @ lower.conj().transpose(0, 2, 1))[:, -1]
    return out


def _eigen_direction(grid: GridResponse, wanted: list[int], k: int) -> Complex:
    usable = np.flatnonzero(grid.in_band[k])
    pick = np.ix_(usable, usable)
    vectors = scipy.linalg.eigh(grid.gram[k, wanted].sum(axis=0)[pick], grid.total[k][pick])[1]
    direction = np.zeros(grid.in_band.shape[1], dtype=np.complex128)
    direction[usable] = vectors[:, -1]
    return full_scale(direction[:, None])[:, 0]


def _peaks(score: NDArray[np.floating]) -> list[int]:
    """Indices of the local maxima that are feasible (not negative), best first."""
    padded = np.concatenate([[-np.inf], score, [-np.inf]])
    top = (score >= 0) & (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])
    indices = np.flatnonzero(top)
    return [int(k) for k in indices[np.argsort(-score[indices])]]
