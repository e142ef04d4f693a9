"""The group `best_rows` of a table file: the row of the sweep that is played for each combination of zones and level.

A row is an index into the tabulated sweep, its drive scaled to the level, and the tabulated figures of that drive
(precompute.sweep.best says which row is the best). tables/FORMAT.md lists the arrays for readers in other languages.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import h5py
import numpy as np

from base.arrays import Complex
from engine.device import Device
from engine.table.levels import LEVEL_TOLERANCE_DB
from engine.table.netcdf_file import TableWriter, Variable
from engine.table.soundness import Arrays

GROUP = "best_rows"
_LEVEL = Variable("level", ("level",), "dB", "wanted level of every wanted zone; infinite: full scale")
_COMBINATION = Variable("combination", ("combination",), "1", "wanted zones, sum of 2**zone")
_ROW = ("level", "combination")
_ZONE = (*_ROW, "zone")
_ACTUATOR = (*_ROW, "actuator")
_VARIABLES = {
    "group": Variable("group", _ROW, "1", "group of the sweep that holds the row"),
    "index": Variable("row", _ROW, "1", "index of the row in that group, in C order and without the axis of zones"),
    "frequencies_hz": Variable("drive_frequency", _ACTUATOR, "Hz", "frequency of each actuator"),
    "amplitudes": Variable("drive_amplitude", _ACTUATOR, "1", "amplitude scaled to the level, fraction of full scale"),
    "phases_rad": Variable("drive_phase", _ACTUATOR, "rad", "phase of each actuator"),
    "level_db": Variable("reached_level", _ROW, "dB", "level of the peak acceleration in the weakest wanted zone"),
    "achieved": Variable("achieved", _ROW, "1", "1: every wanted zone reaches the wanted level"),
    "localized_factor": Variable("localized_factor", _ROW, "1", "share of the wanted zones, paper eq. (11)"),
    "limited_by": Variable("limited_by", _ROW, "1", "what limited the localized factor or the level"),
    "shares": Variable("share", _ZONE, "1", "localized factor of each zone, paper eq. (10)"),
    "peaks_m_per_s2": Variable("peak_acceleration", _ZONE, "m s-2", "greatest peak acceleration in the zone"),
    "dead_spots_m_per_s2": Variable("dead_spot", _ZONE, "m s-2", "least peak acceleration in the zone"),
}


@dataclass(frozen=True)
class BestRow:
    """The drive of a row of the sweep, scaled to a level, and its tabulated figures by zone, on the bar untouched."""

    zones: tuple[int, ...]  # indices of the wanted zones
    wanted_level_db: float  # infinite: as much as full scale gives
    group: str  # "sweep" or "coherent_sweep"
    index: int  # of the row in its group, in C order and without the axis of zones
    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    level_db: float
    """Level of the peak acceleration in the weakest wanted zone; of two frequencies over the root of the sum of both
    squared thresholds (`precompute.sweep.tabulate`)."""
    achieved: bool
    localized_factor: float  # share of the wanted zones together
    limited_by: str
    shares: tuple[float, ...]
    peaks_m_per_s2: tuple[float, ...]
    dead_spots_m_per_s2: tuple[float, ...]

    @property
    def sounding(self) -> list[int]:
        """Indices of the actuators that move."""
        return [actuator for actuator, amplitude in enumerate(self.amplitudes) if amplitude > 0]

    @property
    def complex_amplitudes(self) -> Complex:
        """Complex amplitudes (actuator,), fractions of full scale."""
        return np.array(self.amplitudes) * np.exp(1j * np.array(self.phases_rad))

    @property
    def frequency_hz(self) -> float | None:
        """The one frequency of the drive; None where it has two."""
        different = {self.frequencies_hz[actuator] for actuator in self.sounding}
        return different.pop() if len(different) == 1 else None


class BestRows(Mapping[int, Sequence[BestRow]]):
    """The best rows by combination of wanted zones, the sum of 2**zone; of each combination by rising level."""

    def __init__(self, rows: Iterable[BestRow], amplitude_limit: float) -> None:
        self._rows: dict[int, list[BestRow]] = {}
        self._limit = amplitude_limit
        for row in rows:
            self._rows.setdefault(combination_of(row.zones), []).append(row)

    def __getitem__(self, combination: int) -> Sequence[BestRow]:
        return self._rows[combination]

    def __iter__(self) -> Any:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def at(self, combination: int, level_db: float) -> BestRow | None:
        """The row of a combination at any level; None where the table has none.

        Between two levels it is the lower row where full scale lets it reach the level, since the localized factor only
        falls with rising level; otherwise the higher row, softer.
        """
        rows = self._rows.get(combination)
        if rows is None:
            return None
        last = len(rows) - 1
        higher = next((i for i, row in enumerate(rows) if row.wanted_level_db >= level_db), last)
        if rows[higher].wanted_level_db == level_db:
            return rows[higher]
        if higher > 0 and (louder := _scaled_to(rows[higher - 1], level_db, self._limit)).achieved:
            return louder
        return _scaled_to(rows[higher], level_db, self._limit)


def combination_of(zones: Iterable[int]) -> int:
    """A combination of zones as one number."""
    return sum(1 << zone for zone in set(zones))


def _scaled_to(row: BestRow, level_db: float, amplitude_limit: float) -> BestRow:
    headroom_db = 20 * math.log10(amplitude_limit / max(row.amplitudes))
    change_db = min(headroom_db, level_db - row.level_db)
    scale = 10 ** (change_db / 20)
    return replace(
        row,
        wanted_level_db=level_db,
        amplitudes=tuple(scale * amplitude for amplitude in row.amplitudes),
        peaks_m_per_s2=tuple(scale * peak for peak in row.peaks_m_per_s2),
        dead_spots_m_per_s2=tuple(scale * dead for dead in row.dead_spots_m_per_s2),
        level_db=row.level_db + change_db,
        achieved=row.level_db + change_db >= level_db - LEVEL_TOLERANCE_DB,
    )


def write_best_rows(writer: TableWriter, rows: Mapping[int, Sequence[BestRow]], device: Device) -> None:
    """Write the group `best_rows`."""
    write = partial(writer.write, GROUP)
    levels = list(zip(*rows.values(), strict=True))
    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable.names("zone"), [zone.name for zone in device.zones])
    write(_LEVEL, np.array([row[0].wanted_level_db for row in levels], dtype=np.float64))
    write(_COMBINATION, np.array(list(rows), dtype=np.int64))
    for key, variable in _VARIABLES.items():
        values = [[getattr(row, key) for row in level] for level in levels]
        is_text, is_whole = isinstance(values[0][0], str), key in ("index", "achieved")
        write(variable, np.array(values, dtype=object if is_text else np.int64 if is_whole else np.float64))


def read_best_rows(arrays: Arrays, device: Device) -> BestRows:
    """Best rows of the group with these open arrays."""
    columns = {key: _values(arrays[variable.name]) for key, variable in _VARIABLES.items()}
    rows = []
    for level, level_db in enumerate(arrays["level"][...].tolist()):
        for place, combination in enumerate(arrays["combination"][...].tolist()):
            values = {key: column[level][place] for key, column in columns.items()}
            values |= {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
            zones = tuple(zone for zone in range(len(device.zones)) if combination >> zone & 1)
            rows.append(BestRow(zones, level_db, **values | {"achieved": bool(values["achieved"])}))
    return BestRows(rows, device.limits.amplitude)


def _values(array: h5py.Dataset) -> list[Any]:
    return (array.asstr() if h5py.check_string_dtype(array.dtype) else array)[...].tolist()
