"""Search for the best drive of a problem: scan all frequencies, climb from the best basins, bound what is left.

The problem (entries.objective) is not convex. For one tone it is small: at each frequency only the amplitudes and
phases are free. So every frequency is scanned with a fixed lattice of directions, in single precision; the best
direction of each is climbed; the best peaks over frequency are climbed further with the frequency free. One tone for
all actuators gives a coherent drive, or a single tone where one actuator is enough.

A bound by duality (entries.dual_bound) then says what any drive could still gain. Where that is more than GAP_DB,
several tones may be better: columns are generated until the bound settles, and drives of two and more tones are climbed
from the mixtures that it names and from the best pairs of frequencies. Where the bound meets the best drive, the drive
is the global optimum; otherwise the gap is reported with it.

Frequencies end on the steps of the wire. Between the frequencies of the problem the forms are interpolated, so the
solver climbs the last steps again on forms at the drive's own frequencies (`polish`).
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from precompute.entries.ascent import PENALTY, SHARPEST, STIFF_PENALTY, climb
from precompute.entries.bfgs import climb_each, refine
from precompute.entries.dual_bound import Columns, Tone, block_directions, compute_bound, peaks
from precompute.entries.found_drive import FoundDrive, evaluate_drive, forms_at
from precompute.entries.objective import Problem
from precompute.entries.scan import scan, scan_pairs
from precompute.model.frequencies import BEAT_HZ, on_the_wire

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Single = NDArray[np.float32]

TIE_DB = 0.01
"""Drives whose values differ by less are ties: the one that rises faster is taken, then the louder one."""
GAP_DB = 0.03
"""A gap to the bound that is this small is not worth more search."""
_SILENT = -700.0  # logarithm of a wanted power that every drive exceeds: nothing is wanted
_LEVEL_MARGIN = 10 ** (5e-4 / 10)  # so that smoothing does not leave a level short
_SHORT = 0.99  # of a level: a climb that ends between this and the level is climbed again
_LATTICE = (11, 26)  # amplitude ratios and phases of two actuators
_THREE_DIRECTIONS, _MANY_DIRECTIONS = 800, 2000
_BASINS, _MANY_BASINS = 4, 8
_COLUMN_ROUNDS = 25
_POLISH = 300.0, SHARPEST  # next to an optimum
_STRIDE_HZ = 2.0  # basins are looked for this far apart, climbing at each frequency
_TOLERANCE_HZ = 0.04  # of the best frequency; nothing changes within so little
_NEAR_DB, _NEAR_MANY_DB = 1.5, 4.0
_PAIRS = 5  # two tones are climbed from this many starts for each way to share the actuators
_PAIR_RATIOS = np.geomspace(1e-3, 1e3, 25)
_FIRST_CLIMB = 40.0, 200.0  # sharp enough to compare basins
_SEED = 3


@dataclass(frozen=True)
class Found:
    """The best drive above a level, its ties within TIE_DB, and the upper bound for drives above that level."""

    drive: FoundDrive
    ties: tuple[FoundDrive, ...]
    bound: float


@dataclass(frozen=True)
class Start:
    """Where a climb begins: amplitude (actuator,), frequency_hz (tone,), tone (actuator,), reach_hz (tone, 2)."""

    amplitude: Complex
    frequency_hz: Array
    tone: NDArray[np.int64]
    reach_hz: Array


class Search:
    """The search of one problem. It is scanned once for all wanted powers over threshold."""

    def __init__(self, problem: Problem, wanted: Sequence[float]) -> None:
        self.problem = problem
        self._wanted = [0.0, *wanted]
        self._count = problem.in_band.shape[1]
        hz = problem.frequency_hz
        steps = np.searchsorted(hz, np.arange(hz[0], hz[-1], _STRIDE_HZ))
        edges = np.flatnonzero((problem.in_band[1:] != problem.in_band[:-1]).any(axis=1))
        self._looked_at = np.unique(np.concatenate([steps, edges, edges + 1, [len(hz) - 1]]))
        self._coarse = problem.at(self._looked_at).muted()
        self._directions = search_directions(self._count)
        self._score, self._arg = self._scan()
        self._climbs: dict[float, tuple[Complex, Array]] = {}

    def best(self, wanted: float, more: Sequence[Start] = ()) -> Found | None:
        """The best drive that reaches `wanted` (one of those given, or 0), climbed from the basins and from `more`.

        None if the search finds none.
        """
        starts = [*self._starts(wanted), *more]
        drives = [drive for drive in self._climb(starts, wanted) if drive.loudness >= wanted]
        if not drives:
            return None
        best = max(drives, key=lambda drive: drive.value)
        bound = compute_bound(self.problem, best, wanted)
        if _db(bound / best.value) > GAP_DB:
            bound, mixed = self._mix(best, bound, starts, wanted)
            drives += mixed
            best = max(drives, key=lambda drive: drive.value)
        ties = tuple(drive for drive in drives if drive is not best and _db(best.value / drive.value) <= TIE_DB)
        return Found(best, ties, max(bound, best.value))

    def basins(self) -> list[FoundDrive]:
        """The local optima over frequency where no level is wanted, for a choice by another rule."""
        return climb_all(self.problem, list(self._starts(0.0)), 0.0)

    def _scan(self) -> tuple[Single, NDArray[np.int64]]:
        directions = pack_directions(self._directions)
        score = np.empty((len(self._looked_at), len(self._wanted) + 1), dtype=np.float32)
        arg = np.empty(score.shape, dtype=np.int64)
        wanted = np.array(self._wanted, dtype=np.float32)
        numerator, denominator, level = map(pack_forms, self._coarse.stacks)
        scan(numerator, denominator, level, directions, wanted, score, arg)
        return score, arg

    def edges(self, wanted: float) -> list[Start]:
        """Starts where the best value over frequency crosses `wanted`.

        For a search of the loudest drive these are the ends of the frequencies at which a level can be reached. Few
        drives reach it there, and none of them is a direction of the lattice.
        """
        drives, score = self._climbed(0.0)
        hz, reaches = self._coarse.frequency_hz, score >= wanted
        found = list[Start]()
        for k in np.flatnonzero(reaches[1:] != reaches[:-1]):
            inside = int(k + reaches[k + 1])
            at = float(np.interp(wanted, *_rising(score[k : k + 2], hz[k : k + 2])))
            reach = sorted((hz[2 * k + 1 - inside], hz[inside]))
            found.append(
                Start(drives[inside], np.array([at]), np.zeros(self._count, dtype=np.int64), np.array([reach]))
            )
        return found

    def _climbed(self, wanted: float) -> tuple[Complex, Array]:
        """The best direction of the scan at each frequency, climbed, and its value; -1 where no actuator may play."""
        if wanted in self._climbs:
            return self._climbs[wanted]
        column = self._wanted.index(wanted)
        arg = np.where(self._score[:, column] >= 0, self._arg[:, column], self._arg[:, -1])
        drives = np.ascontiguousarray(self._directions[:, arg].T)
        usable, value = np.ascontiguousarray(self._coarse.in_band), np.empty(len(drives))
        some = usable.any(axis=1)
        drives[~usable] = 0
        drives[~some] = 1
        numerator, denominator, level = self._coarse.stacks
        climb_each(drives, usable, numerator, denominator, level, _log(wanted), *_FIRST_CLIMB, value)
        climbed = self._climbs[wanted] = drives, np.where(some, np.exp(np.clip(value, -700, 700)), -1.0)
        return climbed

    def _starts(self, wanted: float) -> Iterator[Start]:
        """Coherent starts at the best peaks over frequency, and there at directions that nearly reach the level."""
        drives, score = self._climbed(wanted)
        hz, taken = self._coarse.frequency_hz, self._arg[:, self._wanted.index(wanted)]
        for k in peaks(score)[: _BASINS if self._count <= 2 else _MANY_BASINS]:
            reach = np.array([[hz[max(k - 1, 0)], hz[min(k + 1, len(hz) - 1)]]])
            nearly = self._nearly(k, wanted) if wanted else taken[k]
            for drive in [drives[k], *([] if nearly == taken[k] else [self._directions[:, nearly]])]:
                yield Start(drive, hz[k : k + 1], np.zeros(self._count, dtype=np.int64), reach)

    def _nearly(self, k: int, wanted: float) -> np.int64:
        """The best direction of the lattice at a frequency where what it lacks of the level, in dB, counts twice.

        Few directions reach a high level, and the best of those may be at another hill than the best drive.
        """
        forms, directions = (stack[:, k] for stack in self._coarse.stacks), self._directions
        powers = (np.einsum("ad,iab,bd->id", directions.conj(), form, directions).real for form in forms)
        numerator, denominator, level = powers
        reached = np.minimum(level.min(axis=0, initial=np.inf) / wanted, 1.0)
        return np.argmax(numerator.min(axis=0) / denominator.max(axis=0) * reached**2)

    def _mix(
        self, best: FoundDrive, bound: float, starts: list[Start], wanted: float
    ) -> tuple[float, list[FoundDrive]]:
        """Tighten the bound by column generation; return it with drives of several tones that may be better."""
        columns = Columns(self.problem, wanted)
        if best.family in ("single tone", "coherent"):
            columns.add(float(best.frequency_hz[0]), best.amplitude)
        for start in starts:
            if len(start.frequency_hz) == 1:
                columns.add(float(start.frequency_hz[0]), start.amplitude)
        columns.add_single(int(abs(self.problem.frequency_hz - best.frequency_hz[0]).argmin()))
        for _ in range(_COLUMN_ROUNDS):
            solved = columns.solve()
            if solved is None:
                break
            weights, reached = solved
            bound = min(bound, columns.price(weights))
            if _db(bound / reached) < GAP_DB:
                break
        if self._count == 1 or _db(bound / best.value) <= GAP_DB:
            return bound, []
        return bound, list(self._several_tones(columns, best, wanted))

    def _climb(self, starts: list[Start], wanted: float) -> Iterator[FoundDrive]:
        """Climb from every start; starts with equal numbers of tones are climbed together."""
        for count in sorted({len(start.frequency_hz) for start in starts}):
            same = [start for start in starts if len(start.frequency_hz) == count]
            yield from climb_all(self.problem, same, wanted)

    def _several_tones(self, columns: Columns, best: FoundDrive, wanted: float) -> Iterator[FoundDrive]:
        """Drives of two tones where two frequencies come near the best drive; of more where columns mix more."""
        starts = [start for tones in columns.mixtures() if (start := self._start_of(tones))]
        for first in two_blocks(self._count):
            starts += self._pair_starts(first, columns, best, wanted)
        yield from (drive for drive in self._climb(starts, wanted) if drive.loudness >= wanted)

    def _pair_starts(self, first: list[int], columns: Columns, best: FoundDrive, wanted: float) -> Iterator[Start]:
        """Starts of two tones, one for these actuators and one for the others, in the directions of the prices."""
        second = [actuator for actuator in range(self._count) if actuator not in first]
        coarse, hz = self._coarse, self._coarse.frequency_hz
        drives = [block_directions(coarse, columns.weights, block) for block in (first, second)]
        powers = [_powers_each(coarse, drive) for drive in drives]
        value, partner, ratio = np.empty(len(hz)), np.empty(len(hz), dtype=np.int64), np.empty(len(hz))
        ends = np.cumsum([len(stack) for stack in coarse.stacks])
        scan_pairs(powers[0], powers[1], hz, _PAIR_RATIOS, ends, wanted, BEAT_HZ, value, partner, ratio)
        # Climbing gains more where a block's own direction is a guess.
        near = best.value * 10 ** (-(_NEAR_DB if self._count == 2 else _NEAR_MANY_DB) / 10)
        for k in [k for k in peaks(value) if value[k] >= near][:_PAIRS]:
            other = int(partner[k])
            tones = [
                Tone(float(hz[k]), first, drives[0][k, first]),
                Tone(float(hz[other]), second, drives[1][other, second] * np.sqrt(ratio[k])),
            ]
            if (start := self._start_of(tones)) is not None:
                yield start

    def _start_of(self, tones: list[Tone]) -> Start | None:
        """A start for several tones, each free to move by half of BEAT_HZ; None where two of them would beat."""
        hz = np.array([tone.frequency_hz for tone in tones])
        spare_hz = np.diff(np.sort(hz)).min() - BEAT_HZ
        if spare_hz < 0:
            return None
        owner, amplitude = np.zeros(self._count, dtype=np.int64), np.zeros(self._count, dtype=np.complex128)
        for t, tone in enumerate(tones):
            owner[tone.actuators], amplitude[tone.actuators] = t, tone.amplitude
        reach_hz = hz[:, None] + np.array([-0.5, 0.5]) * min(BEAT_HZ, spare_hz)
        return Start(amplitude, hz, owner, reach_hz)


def two_blocks(count: int) -> Iterator[list[int]]:
    """Every way to share `count` actuators between two tones: those on the first, actuator 0 among them."""
    for others in range(count - 1):
        for chosen in itertools.combinations(range(1, count), others):
            yield [0, *chosen]


def climb_all(problem: Problem, starts: Sequence[Start], wanted: float) -> list[FoundDrive]:
    """Climb from starts of equal numbers of tones, frequencies free within reach and then rounded to the wire's.

    Forms interpolated between coarse frequencies may lose their positive power. A climb that ends there is made again
    with the frequencies of its start kept.
    """
    starts = [start for start in starts if _is_playable(problem, start)]
    climbed = _climbed_from(problem, starts, wanted)
    lost = [i for i, drive in enumerate(climbed) if drive.value <= 0]
    kept = [replace(starts[i], reach_hz=starts[i].frequency_hz[:, None].repeat(2, axis=1)) for i in lost]
    for i, drive in zip(lost, _climbed_from(problem, kept, wanted), strict=True):
        climbed[i] = drive
    return [_lifted(problem, drive, wanted) for drive in climbed if drive.value > 0]


def _climbed_from(problem: Problem, starts: Sequence[Start], wanted: float) -> list[FoundDrive]:
    if not starts:
        return []
    drives = np.array([start.amplitude for start in starts], dtype=np.complex128)
    hz = np.array([start.frequency_hz for start in starts], dtype=np.float64)
    tone = np.array([start.tone for start in starts])
    usable = np.array([_usable(problem, f, t) for f, t in zip(hz, tone, strict=True)])
    reach_hz = np.array([_reach(problem, *pair) for pair in zip(starts, usable, strict=True)])
    low_hz, high_hz = (np.ascontiguousarray(reach_hz[:, :, end]) for end in (0, 1))
    drives[~usable] = 0
    multipliers = np.empty((len(starts), sum(map(len, problem.stacks)) + tone.shape[1]))
    plain = drives, usable, *problem.stacks, problem.frequency_hz
    for tolerance_hz in (_TOLERANCE_HZ, np.inf):
        tail = tone, low_hz, high_hz, _log(wanted), tolerance_hz, multipliers
        refine(*plain, hz, *tail)
        hz = on_the_wire(hz)
    return [evaluate_drive(problem, hz[i][tone[i]], drives[i], multipliers[i]) for i in range(len(starts))]


def polish(problem: Problem, drive: FoundDrive, wanted: float) -> FoundDrive:
    """The drive climbed once more, its frequencies kept, on a problem that holds exactly these frequencies."""
    return _lifted(problem, _climbed_again(problem, drive, wanted, PENALTY), wanted)


def _lifted(problem: Problem, drive: FoundDrive, wanted: float) -> FoundDrive:
    """A climbed drive, and one that lets some 0.005 dB of the level go, since they are worth much, without that."""
    is_short = _SHORT * wanted <= drive.loudness < wanted
    return _climbed_again(problem, drive, wanted, STIFF_PENALTY) if is_short else drive


def _climbed_again(problem: Problem, drive: FoundDrive, wanted: float, penalty: float) -> FoundDrive:
    tones, tone = np.unique(drive.frequency_hz, return_inverse=True)
    forms = [forms_at(stack, problem.frequency_hz, tones, tone) for stack in problem.stacks]
    amplitude, multipliers = drive.amplitude.copy(), np.empty(sum(map(len, forms)) + len(tone))
    numerator, denominator, level = forms
    usable = _usable(problem, tones, tone)
    usable.flags.writeable = False  # as `refine` has it: for another kind of array `climb` would be compiled again
    climb(amplitude, usable, numerator, denominator, level, _log(wanted), *_POLISH, multipliers, penalty)
    return evaluate_drive(problem, drive.frequency_hz, amplitude, multipliers)


def search_directions(count: int) -> Complex:
    """Shape (actuator, direction), the strongest actuator at 1: a lattice for two actuators, seeded random beyond."""
    unit = np.eye(count, dtype=np.complex128)
    if count == 1:
        return unit
    if count == 2:
        ratios, phases = _LATTICE
        angle = np.pi / 2 * np.linspace(0.0, 1.0, ratios + 2)[1:-1, None]
        turned = np.sin(angle) * np.exp(2j * np.pi * np.arange(phases) / phases)
        pairs = np.stack([np.broadcast_to(np.cos(angle) + 0j, turned.shape), turned])
        directions = np.concatenate([unit, pairs.reshape(2, -1)], axis=1)
    else:
        number = _THREE_DIRECTIONS if count == 3 else _MANY_DIRECTIONS
        parts = np.random.default_rng(_SEED).normal(size=(2, count, number))
        directions = np.concatenate([unit, parts[0] + 1j * parts[1]], axis=1)
    out: Complex = directions / abs(directions).max(axis=0)
    return out


def pack_forms(forms: Complex) -> Single:
    """Shape (form, frequency, actuator squared): diagonal, then twice the real and imaginary parts above it."""
    above = np.triu_indices(forms.shape[-1], 1)
    diagonal = np.einsum("ifaa->ifa", forms).real
    off = forms[..., above[0], above[1]]
    return np.ascontiguousarray(np.concatenate([diagonal, 2 * off.real, 2 * off.imag], axis=-1), dtype=np.float32)


def pack_directions(directions: Complex) -> Single:
    """Shape (actuator squared, direction), so that the product with a packed form is a^H H a."""
    above = np.triu_indices(len(directions), 1)
    cross = directions[above[0]].conj() * directions[above[1]]
    return np.ascontiguousarray(np.concatenate([abs(directions) ** 2, cross.real, -cross.imag]), dtype=np.float32)


def _powers_each(problem: Problem, drives: Complex) -> Array:
    """Powers (frequency, form) of one drive (frequency, actuator) at each frequency, its actuators' at the end."""
    forms = np.concatenate(problem.stacks)
    powers = np.einsum("fa,ifab,fb->fi", drives.conj(), forms, drives, optimize=True).real
    return np.ascontiguousarray(np.concatenate([powers, abs(drives) ** 2], axis=1))


def start_at(drive: FoundDrive) -> Start:
    """A start at a drive, each tone free to move by a stride."""
    tones, tone = np.unique(drive.frequency_hz, return_inverse=True)
    return Start(drive.amplitude, tones, tone, tones[:, None] + np.array([-_STRIDE_HZ, _STRIDE_HZ]))


def _rising(values: Array, at: Array) -> tuple[Array, Array]:
    order = np.argsort(values)
    return values[order], at[order]


def _usable(problem: Problem, hz: Array, tone: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each actuator may play its tone: at the frequency of the problem next to it."""
    nearest = abs(problem.frequency_hz[:, None] - hz).argmin(axis=0)
    usable: NDArray[np.bool_] = problem.in_band[nearest[tone], np.arange(len(tone))]
    return usable


def _is_playable(problem: Problem, start: Start) -> bool:
    """Whether each tone has an actuator whose band holds it."""
    usable = _usable(problem, start.frequency_hz, start.tone) & (start.amplitude != 0)
    return len(np.unique(start.tone[usable])) == len(start.frequency_hz)


def _reach(problem: Problem, start: Start, usable: NDArray[np.bool_]) -> Array:
    """Reach of each tone (tone, 2), within the bands of the actuators that play it."""
    reach_hz = np.clip(start.reach_hz, problem.frequency_hz[0], problem.frequency_hz[-1])
    for actuator in np.flatnonzero(usable):
        band_hz = problem.frequency_hz[problem.in_band[:, actuator]]
        own = reach_hz[start.tone[actuator]]
        own[:] = np.clip(own, band_hz[0], band_hz[-1])
    return reach_hz


def _log(wanted: float) -> float:
    return float(np.log(wanted * _LEVEL_MARGIN)) if wanted > 0 else _SILENT


def _db(ratio: float) -> float:
    return float(10 * np.log10(ratio)) if ratio > 0 else np.inf
