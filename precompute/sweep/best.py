"""The best row of the sweep for every combination of zones and level: the published method, ready to be looked up.

Of all rows of both sweeps whose peak acceleration reaches the level in every wanted zone within the amplitude limit,
the best has the greatest localized factor summed over the wanted zones (paper eq. (11)). The factor of a row depends on
the ratio of its amplitudes only, and peaks grow with them. So each ratio is one row, scaled to the level. The rules:

- A combination is the zones that are wanted. All others count alike, whether a finger rests there or not. There are all
  combinations up to eight zones, beyond that those of one to three zones.
- Two frequencies are BEAT_HZ apart at least: closer ones beat within a touch. A row that moves one actuator, or both at
  one frequency, is one of the coherent sweep.
- A peak's level is over the threshold of the row: of its frequency, or of both together (engine.table.best_rows).
- Where no row reaches the level, and for full scale, the best is the row whose weakest wanted zone gets the highest
  level at the amplitude limit.
- Factors are compared to STEP, which is above the rounding of the tabulated values. Of equals the best is the one whose
  weakest wanted zone gets the highest level at the amplitude limit, and then the first: rows of one frequency first,
  each sweep in the order of the table.

No drive is solved here: `BestRowSearch` gets the tabulated values chunk by chunk while they are written, so memory
stays bounded.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from base.arrays import Array, Single
from engine.device import Device
from engine.table.best_rows import BestRow, BestRows, combination_of

Figures = Sequence[Single]  # factor, peak and dead spot
Drive = tuple[int, tuple[float, ...], tuple[float, ...], tuple[float, ...]]
"""Index of a row, and frequency, amplitude (the strongest is 1) and phase by actuator."""

ALL_UP_TO, MOST_BEYOND = 8, 3  # zones up to which every combination has rows; zones of a combination beyond that
STEP = 1e-4  # localized factors closer than this are equal
_UNLIMITED = "nothing: no row of the sweep has a greater localized factor"
_BY_LEVEL = "level: rows of a greater localized factor do not reach it within full scale"
_BY_SCALE = "full scale: no row is louder in the weakest wanted zone"


class Rows(NamedTuple):
    """A chunk of one sweep, the strongest actuator at full scale."""

    group: str
    figures: Figures  # each (zone, *row)
    threshold_m_per_s2: Single  # shape that broadcasts to the rows
    drive_at: Callable[[tuple[int, ...]], Drive]


@dataclass(frozen=True)
class _Best:
    value: float  # what is compared first: the localized factor in steps; for full scale the level as a ratio
    weakest: float  # peak over threshold in the weakest wanted zone, the strongest actuator at full scale
    group: str
    figures: Array  # factor, peak and dead spot (figure, zone)
    drive: Drive


class BestRowSearch:
    """The best rows of one device among the rows that `take_rows` has got."""

    def __init__(self, device: Device) -> None:
        self._device, self._limit = device, device.limits.amplitude
        self._best: dict[tuple[tuple[int, ...], float], _Best] = {}

    def take_rows(self, rows: Rows) -> None:
        """Compare more rows of the sweep with the best ones so far; figures that are NaN are no rows."""
        factor, peak, _ = (np.nan_to_num(figure, copy=True) for figure in rows.figures)
        level = peak / rows.threshold_m_per_s2
        for zones, share, weakest in _combinations(factor, level):
            self._improve((zones, math.inf), rows, weakest, weakest)
            steps = np.rint(share / np.float32(STEP))
            for level_db in (-math.inf, *self._device.levels_db):
                best = self._best.get((zones, level_db))
                if best is None or steps.max() >= best.value:
                    reached = weakest * self._limit >= 10 ** (level_db / 20)
                    self._improve((zones, level_db), rows, np.where(reached, steps, np.float32(0)), weakest)

    def _improve(self, key: tuple[tuple[int, ...], float], rows: Rows, value: Single, weakest: Single) -> None:
        greatest, best = float(value.max()), self._best.get(key)
        if greatest <= 0 or (best is not None and greatest < best.value):
            return
        of_equals = np.where(value == greatest, weakest, np.float32(-1))
        at = tuple(map(int, np.unravel_index(of_equals.argmax(), value.shape)))
        if best is None or (greatest, weakest[at]) > (best.value, best.weakest):
            figures = np.array([[of_zone[at] for of_zone in figure] for figure in rows.figures], dtype=np.float64)
            self._best[key] = _Best(greatest, float(weakest[at]), rows.group, figures, rows.drive_at(at))

    def best_rows(self) -> BestRows:
        """The best row of every combination at every level, scaled to it."""
        combinations = sorted({zones for zones, _ in self._best}, key=combination_of)
        levels_db = (*self._device.levels_db, math.inf)
        return BestRows((self._row(zones, level_db) for level_db in levels_db for zones in combinations), self._limit)

    def _row(self, zones: tuple[int, ...], level_db: float) -> BestRow:
        best, loudest = self._best.get((zones, level_db)), self._best[zones, math.inf]
        achieved = best is not None
        best = best or loudest
        is_at_limit = best is loudest
        scale = self._limit if is_at_limit else 10 ** (level_db / 20) / best.weakest
        index, frequencies_hz, amplitudes, phases_rad = best.drive
        factor, peak, dead = best.figures
        greatest = self._best[zones, -math.inf].value
        limit = _BY_SCALE if is_at_limit else _UNLIMITED if best.value == greatest else _BY_LEVEL
        return BestRow(
            zones=zones,
            wanted_level_db=level_db,
            group=best.group,
            index=index,
            frequencies_hz=frequencies_hz,
            amplitudes=tuple(scale * amplitude for amplitude in amplitudes),
            phases_rad=phases_rad,
            level_db=20 * math.log10(scale * best.weakest),
            achieved=achieved,
            localized_factor=float(factor[list(zones)].sum()),
            limited_by=limit,
            shares=tuple(factor.tolist()),
            peaks_m_per_s2=tuple((scale * peak).tolist()),
            dead_spots_m_per_s2=tuple((scale * dead).tolist()),
        )


def _combinations(factor: Single, level: Single) -> Iterator[tuple[tuple[int, ...], Single, Single]]:
    """Every combination of zones, with the sum of its factors and the level of its weakest zone, for each row."""
    most = len(factor) if len(factor) <= ALL_UP_TO else MOST_BEYOND

    def descend(
        chosen: tuple[int, ...], share: Single, weakest: Single
    ) -> Iterator[tuple[tuple[int, ...], Single, Single]]:
        yield chosen, share, weakest
        if len(chosen) < most:
            for zone in range(chosen[-1] + 1, len(factor)):
                yield from descend((*chosen, zone), share + factor[zone], np.minimum(weakest, level[zone]))

    for zone in range(len(factor)):
        yield from descend((zone,), factor[zone], level[zone])
