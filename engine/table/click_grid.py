"""The clicks of a table as arrays with a row for each click, found by the places and roles of the fingers.

A table holds some ten thousand clicks and a touch needs one, so an entry (engine.table.click_entry) is made when it is
asked for. Rows are found by the key of a placement (engine.touch.places): those of one and two fingers by a dense array
of row numbers, which the compiled step reads too, those of more fingers by a dictionary.
"""

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Integers, Mask
from engine.table.click_entry import ClickEntry, ClickFinger, LevelSpread
from engine.touch.places import Key, Places
from firmware_link.protocol.basis import Basis

NO_FINGER = -1  # stands in `finger_place` behind the last finger of a row
NO_ROW = -1  # stands in `pair` where the table holds no such click
FIGURES = ("peak_s", "residual_from_s", "residual_db")  # fields of an entry that are one real number


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
