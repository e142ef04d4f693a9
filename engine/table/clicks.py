"""The clicks of a table: entries, and arrays with a row for each, found by the places and roles of the fingers.

A click is the weights of a short waveform for one placement, and what it promises. A table holds some ten thousand and
a touch needs one, so an entry is made when it is asked for. Rows are found by the key of a placement: those of one and
two fingers by a dense array of row numbers, which the compiled step reads too, those of more fingers by a dictionary.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Integers, Mask
from engine.table.levels import LEVEL_TOLERANCE_DB, shifted
from engine.touch import Placement
from engine.touch.placement import Key, Places
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, Samples, weighted_sum

NO_FINGER = -1  # stands in `finger_place` behind the last finger of a row
NO_ROW = -1  # stands in `pair` where the table holds no such click
FIGURES = ("peak_s", "residual_from_s", "residual_db")  # fields of an entry that are one real number


@dataclass(frozen=True)
class LevelSpread:
    """Peak level above threshold, dB: of the nominal plant, and 5th, 50th and 95th percentile of sampled plants.

    worst_db: of all these plants, the weakest where felt, and the strongest where quiet.
    """

    nominal_db: float
    low_db: float
    middle_db: float
    high_db: float
    worst_db: float


@dataclass(frozen=True)
class ClickFinger:
    """Peaks under one finger, in the nominal plant."""

    acceleration_at_finger_m_per_s2: float
    level_db: float  # weighted by the detection threshold


@dataclass(frozen=True, eq=False)
class ClickFigures:
    """Levels and times of a waveform under the fingers of a placement.

    The spreads are over sampled plants; all other figures are of the nominal plant.
    exceeds_s: for each level, rising, the time at which every felt finger has passed its threshold when the click is
    played at that level; None: one of them never does.
    """

    felt: LevelSpread  # the weakest felt finger
    quiet: LevelSpread | None  # the strongest quiet finger; None: nothing is quiet
    fingers: tuple[ClickFinger, ...]  # for each finger of the placement, in order
    exceeds_s: Mapping[float, float | None]
    peak_s: float  # when the last felt finger has its peak
    residual_from_s: float
    residual_db: float  # the strongest felt finger from residual_from_s on


@dataclass(frozen=True, eq=False)
class ClickEntry(ClickFigures):
    """Weights (function,) of a set of a basis, played at `amplitude` (fraction of full scale), and their figures.

    A weight is in steps of 2^-fraction_bits. placement: the positions of the places that the click is made for; each
    finger lies within `tolerance_m` of its place in the sampled plants.
    """

    placement: Placement
    tolerance_m: float
    basis: Basis
    basis_set: int
    weights: NDArray[np.int16]
    fraction_bits: int
    amplitude: float = 1.0
    wanted_level_db: float = math.inf  # the level that is asked for; infinite: as strong as solved

    @property
    def achieved(self) -> bool:
        """Whether the wanted level is reached: full scale and the quiet level may allow less."""
        return math.isinf(self.wanted_level_db) or self.level_db >= self.wanted_level_db - LEVEL_TOLERANCE_DB

    @property
    def level_db(self) -> float:
        """The level that 95 % of the sampled plants reach under every felt finger."""
        return self.felt.low_db

    @cached_property
    def samples(self) -> Samples:
        """Base displacement (sample, actuator) at full amplitude, linear between samples, of SAMPLE_FULL_SCALE."""
        number = self.basis.number_of_actuators
        return weighted_sum(self.basis.sets[self.basis_set], self.weights, self.fraction_bits, number).astype(np.int16)

    @property
    def waveform(self) -> Array:
        """Base displacement (sample, actuator) as played, a fraction of full scale, linear between samples."""
        return self.amplitude / SAMPLE_FULL_SCALE * self.samples.astype(np.float64)

    @property
    def sample_rate_hz(self) -> int:
        """Rate of the samples."""
        return self.basis.sample_rate_hz

    @property
    def length_s(self) -> float:
        """Length of the waveform."""
        return (self.basis.sets[self.basis_set].samples - 1) / self.sample_rate_hz

    def exceeds_at_s(self) -> float | None:
        """When every felt finger has passed its threshold, at the wanted level or the next lower tabulated one."""
        levels_db = [level_db for level_db in self.exceeds_s if level_db <= self.wanted_level_db]
        return self.exceeds_s[max(levels_db)] if levels_db else None


def played_at(click: ClickEntry, level_db: float) -> ClickEntry:
    """The click played softer, so that just 95 % of the plants reach `level_db`; never louder than tabulated.

    All levels fall together, so quiet fingers stay below what was promised. ESTIMATE: the actuators are linear.
    """
    change_db = min(0.0, level_db - click.level_db)
    scale = 10 ** (change_db / 20)
    return replace(
        click,
        amplitude=click.amplitude * scale,
        wanted_level_db=level_db,
        felt=shifted(click.felt, change_db),
        quiet=click.quiet and shifted(click.quiet, change_db),
        fingers=tuple(
            ClickFinger(each.acceleration_at_finger_m_per_s2 * scale, each.level_db + change_db)
            for each in click.fingers
        ),
        residual_db=click.residual_db + change_db,
    )


@dataclass(frozen=True, eq=False)
class Clicks(Sequence[ClickEntry]):
    """Clicks at full amplitude. NaN stands for absence.

    finger_place, is_felt (row, finger): index of each finger's place, rising, NO_FINGER behind the last; its role.
    weights (row, function) of the set `basis_set` (row,) of the basis, 0 beyond it, in steps of 2^-fraction_bits.
    felt_db, quiet_db (row, spread): fields of LevelSpread. finger_m_per_s2, finger_db (row, finger). exceeds_s (row,
    level). The others are (row,); `basis` is None where there are no clicks.
    """

    places: Places
    tolerance_m: float
    basis: Basis | None
    levels_db: tuple[float, ...]
    finger_place: NDArray[np.int32]
    is_felt: Mask
    weights: NDArray[np.int16]
    fraction_bits: NDArray[np.int32]
    basis_set: NDArray[np.int32]
    felt_db: Array
    quiet_db: Array
    finger_m_per_s2: Array
    finger_db: Array
    exceeds_s: Array
    peak_s: Array
    residual_from_s: Array
    residual_db: Array

    @classmethod
    def of(cls, places: Places, clicks: Sequence[ClickEntry]) -> "Clicks":
        """The arrays of clicks, which share a basis, a tolerance and the levels that are looked at."""
        first = clicks[0] if clicks else None
        assert first is None or all(click.basis.hash == first.basis.hash for click in clicks)
        rows, keys = len(clicks), [places.key(click.placement) for click in clicks]
        fingers = max((len(key) for key in keys), default=1)
        code = _padded(keys, fingers, 2 * NO_FINGER).astype(np.int32)
        figures = [[each.acceleration_at_finger_m_per_s2 for each in click.fingers] for click in clicks]
        levels_db = [[each.level_db for each in click.fingers] for click in clicks]
        functions = max((len(click.weights) for click in clicks), default=0)
        quiet_db = [(np.nan,) * 5 if click.quiet is None else astuple(click.quiet) for click in clicks]
        exceeds = [[np.nan if at_s is None else at_s for at_s in click.exceeds_s.values()] for click in clicks]

        def column(name: str, kind: type = np.float64) -> NDArray[Any]:
            return np.array([getattr(click, name) for click in clicks], dtype=kind)

        return cls(
            places=places,
            tolerance_m=0.0 if first is None else first.tolerance_m,
            basis=None if first is None else first.basis,
            levels_db=tuple(first.exceeds_s) if first else (),
            finger_place=code // 2,
            is_felt=code % 2 == 1,
            weights=_padded([click.weights.tolist() for click in clicks], functions, 0).astype(np.int16),
            fraction_bits=column("fraction_bits", np.int32),
            basis_set=column("basis_set", np.int32),
            felt_db=np.array([astuple(click.felt) for click in clicks]).reshape(rows, 5),
            quiet_db=np.array(quiet_db).reshape(rows, 5),
            finger_m_per_s2=_padded(figures, fingers, np.nan),
            finger_db=_padded(levels_db, fingers, np.nan),
            exceeds_s=np.array(exceeds).reshape(rows, -1) if rows else np.empty((0, 0)),
            **{name: column(name) for name in FIGURES},
        )

    def __len__(self) -> int:
        return len(self.fraction_bits)

    @overload
    def __getitem__(self, row: int) -> ClickEntry: ...
    @overload
    def __getitem__(self, row: slice) -> Sequence[ClickEntry]: ...
    def __getitem__(self, row: int | slice) -> ClickEntry | Sequence[ClickEntry]:
        """The click of a row, or the clicks of some."""
        if isinstance(row, slice):
            return [self._entry(each) for each in range(len(self))[row]]
        return self._entry(range(len(self))[row])

    def __iter__(self) -> Iterator[ClickEntry]:
        return (self._entry(row) for row in range(len(self)))

    @property
    def felt_low_db(self) -> Array:
        """The level (row,) that 95 % of the sampled plants reach under every felt finger."""
        return self.felt_db[:, 1]

    @cached_property
    def pair(self) -> NDArray[np.int32]:
        """The row of the click of two fingers is pair[one + 1, other + 1], with their codes in either order.

        A code is 2 * place + is_felt. It is -1 for no finger, so the row of one finger is pair[0, code + 1]. NO_ROW
        stands where the table holds no such click.
        """
        side = 2 * self.places.count + 1
        found = np.full((side, side), NO_ROW, dtype=np.int32)
        few = np.flatnonzero(self._count <= 2)
        code = self._code[few, :2] + 1
        one = code[:, 0]
        other = code[:, 1] if code.shape[1] == 2 else np.zeros_like(one)
        found[one, other] = found[other, one] = few
        return found

    def row_of(self, key: Key) -> int | None:
        """The row of the click of a placement, found by its key, or None if the table holds no such click."""
        if len(key) > 2:
            return self._row_of_more.get(key)
        codes = (*key, -1, -1)[:2]
        row = int(self.pair[codes[0] + 1, codes[1] + 1])
        return None if row == NO_ROW else row

    def key_of(self, row: int) -> Key:
        """Key of the placement of a row."""
        return tuple(code for code in self._code[row].tolist() if code >= 0)

    def at(self, key: Key) -> ClickEntry | None:
        """The click of a placement, found by its key, or None if the table holds no such click."""
        row = self.row_of(key)
        return None if row is None else self._entry(row)

    @property
    def _code(self) -> NDArray[np.int32]:
        """Code of each finger (row, finger); -1 behind the last."""
        return np.where(self.finger_place < 0, -1, 2 * self.finger_place + self.is_felt)

    @property
    def _count(self) -> Integers:
        """Number of fingers (row,)."""
        return np.count_nonzero(self.finger_place >= 0, axis=1)

    @cached_property
    def _row_of_more(self) -> dict[Key, int]:
        return {self.key_of(row): row for row in np.flatnonzero(self._count > 2).tolist()}

    def _entry(self, row: int) -> ClickEntry:
        assert self.basis is not None  # there is a row
        key = self.key_of(row)
        number, quiet_db = int(self.basis_set[row]), self.quiet_db[row].tolist()
        fingers = zip(self.finger_m_per_s2[row].tolist(), self.finger_db[row].tolist(), strict=True)
        exceeds_s = zip(self.levels_db, self.exceeds_s[row].tolist(), strict=True)
        return ClickEntry(
            placement=self.places.placement(key),
            tolerance_m=self.tolerance_m,
            basis=self.basis,
            basis_set=number,
            weights=self.weights[row, : len(self.basis.sets[number].actuators)],
            fraction_bits=int(self.fraction_bits[row]),
            felt=LevelSpread(*self.felt_db[row].tolist()),
            quiet=None if np.isnan(quiet_db[0]) else LevelSpread(*quiet_db),
            fingers=tuple(ClickFinger(*finger) for finger in fingers)[: len(key)],
            exceeds_s={level_db: None if np.isnan(at_s) else at_s for level_db, at_s in exceeds_s},
            **{name: float(getattr(self, name)[row]) for name in FIGURES},
        )


def _padded(rows: Sequence[Sequence[float]], width: int, absent: float) -> NDArray[Any]:
    """An array (row, width) of rows of different lengths."""
    found = np.full((len(rows), width), absent, dtype=np.float64)
    for own, values in zip(found, rows, strict=True):
        own[: len(values)] = values
    return found
