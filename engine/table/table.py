"""An open table: its device, clicks by placement, modes, best rows and sweep (tables/FORMAT.md)."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import h5netcdf
import h5py
import numpy as np

from base.arrays import Points
from base.points import point_text
from engine.device import Device
from engine.steady.modes import Modes
from engine.table.best_rows import BestRow, BestRows, combination_of, read_best_rows
from engine.table.clicks import ClickEntry, Clicks
from engine.table.clicks import played_at as click_played_at
from engine.table.columns import read_clicks, read_modes
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.table.netcdf_file import FORMAT, FORMAT_REVISION, TableWriter, Values, check_bytes, read_points
from engine.table.schema import IS_SHIPPED, TableError
from engine.table.soundness import check_values, sound_arrays
from engine.touch import Placement
from engine.touch.placement import Places

if TYPE_CHECKING:
    from engine.steady import SteadyDrive
    from engine.steady.steady_solver import SteadySolver

__all__ = ["Table", "TableError"]
_LiveParts = tuple[Device, BestRows, Clicks, Modes | None]
"""The parts that a live engine plays from, read through h5py: h5netcdf takes 5 ms for each variable it opens."""


class Table:
    """An open table: its device, clicks, modes and best rows, and views of the sweep for any zone combination.

    `Table.open` makes one. It is a context manager: the file is closed at its end, all but the sweep stays usable.
    `best_rows`: the rows of the sweep that zones play, none for a bar with one actuator. `clicks`: the tabulated ones,
    one for each placement at the places; a table may have none.
    """

    def __init__(self, path: Path, file: h5netcdf.File, parts: "_LiveParts") -> None:
        self.path = path
        self._file = file
        self.attributes: dict[str, Any] = dict(file.attrs)
        self.device, self.best_rows, self.clicks, self._modes = parts
        self.fingerprint = str(self.attributes["device_fingerprint"])

    @classmethod
    def open(
        cls, path: Path | str, *, device: Device | None = None, code_fingerprint: str | None = None, verify: bool = True
    ) -> Self:
        """Open and verify a table; raises TableError if it is unusable or does not belong to `device` or the code.

        >>> with Table.open("my-bar.nc") as table:
        ...     print(table.device.name, table.is_shipped)
        my-bar False
        """
        path = Path(path)
        sealed = check_bytes(path, verify)
        try:
            parts = _read_inside(path, sealed, verify)
            file = h5netcdf.File(path, "r", decode_vlen_strings=True)
        except Exception as error:  # HDF5 and its readers raise errors of every kind on a malformed file
            raise _as_table_error(path, error) from error
        try:
            table = cls(path, file, parts)
            if table.device.fingerprint != table.fingerprint or (device and device.fingerprint != table.fingerprint):
                raise TableError(f"{path}: {_stale_text(table.device, device)}")
            if code_fingerprint and table.attributes["code_fingerprint"] != code_fingerprint:
                raise TableError(f"{path}: is stale: it was built by another version of the code; build it again")
        except BaseException as error:
            file.close()
            if isinstance(error, Exception):
                raise _as_table_error(path, error) from error
            raise
        return table

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; all but the sweep stays usable."""
        self._file.close()

    def copy_groups(self, writer: TableWriter, groups: Sequence[str]) -> bool:
        """Copy these groups into another table; groups that are absent are skipped. True if any was copied."""
        found = [group for group in groups if group in self._file.groups]
        for group in found:
            writer.copy(group, self._file.groups[group])
        return bool(found)

    @property
    def modes(self) -> Modes:
        """What steady drives at any positions are solved from. Raises TableError where the table has none."""
        if self._modes is None:
            raise TableError(f"{self.path}: has no modes, as packed tables have none; build it")
        return self._modes

    @property
    def is_shipped(self) -> bool:
        """Whether the table was made to be shipped: it has no responses and sweeps."""
        return IS_SHIPPED in self.attributes

    def values(self, group: str, name: str) -> Values:
        """A whole array by its group and name, such as "responses" and "frequency"."""
        return np.asarray(self._file.groups[group].variables[name][...])

    def points(self, group: str, name: str) -> Points:
        """A whole array of points of the surface by its group and name, such as "measured" and "position"."""
        return read_points(self._file.groups[group].variables, name)

    def checksums(self) -> dict[str, int]:
        """CRC-32 of every array, by its group and name, such as "responses/frequency"."""
        return {
            f"{group}/{name}": int(variable.attrs["crc32"])
            for group, found in self._file.groups.items()
            for name, variable in found.variables.items()
        }

    def best_row(self, felt: Sequence[str], level_db: float = DEFAULT_LEVEL_DB) -> BestRow:
        """The row of the sweep that these zones (names) play together, as `BestRows.at` has it between levels.

        Raises DeviceError for an unknown zone, TableError for zones that the table has no row for.

        >>> with Table.open("my-bar.nc") as table:
        ...     row = table.best_row(["I", "III"], level_db=20)
        >>> row.group, row.achieved
        ('coherent_sweep', True)
        """
        combination = combination_of(self.device.zone_index(zone) for zone in _listed(felt))
        row = self.best_rows.at(combination, level_db)
        if row is None:
            raise TableError(f"{self.path}: {self.no_row_text(felt)}")
        return row

    def no_row_text(self, felt: Sequence[str]) -> str:
        """Why there is no best row for these zones, and what to do."""
        if len(self.device.actuators) < 2:
            return f"has no sweep: the {self.device.surface.kind} has one actuator; play it by positions"
        if not self.best_rows:
            return "has no best rows of the sweep, as tables of earlier versions have none; build it again"
        return f"has no row of the sweep for zones {', '.join(felt) or 'none'}: name one to three"

    @property
    def no_sweep_text(self) -> str:
        """Why there is no group `sweep`, and what to do."""
        if len(self.device.actuators) < 2:
            return f"has no sweep of actuator pairs: {self.device.name} has one actuator"
        if not self.device.sweep.is_stored:
            return "holds the best rows of the sweep alone, as [sweep] store = false asks; set it true, and build again"
        return "was packed without its sweep; build it"

    @property
    def places(self) -> Places:
        """The grid of places that clicks are tabulated at, or would be."""
        return self.clicks.places

    def click_for(
        self, felt: Sequence[str | complex], quiet: Sequence[str | complex] = (), level_db: float = DEFAULT_LEVEL_DB
    ) -> ClickEntry:
        """Click for fingers at these positions, `felt` or `quiet`, played at `level_db`.

        A position is a text such as "35 mm", metres, or the name of a zone, which means its middle. The click is that
        of the nearest places. Raises PlacementError for positions that are no placement, TableError where the table
        has no click for this number of fingers.
        """
        placement = Placement.named(self.device, felt, quiet)
        click = self.click_at(placement, level_db)
        if click is None:
            words = ", ".join(map(point_text, placement.position_m))
            raise TableError(
                f"{self.path}: has no click for fingers at {words}: build it with clicks for so many fingers; more "
                "than two, and two at one place, are only solved when they come"
            )
        return click

    def click_at(self, placement: Placement, level_db: float) -> ClickEntry | None:
        """Click of the nearest places, played at a level; None for a placement without a click."""
        click = self.clicks.at(self.places.key(placement))
        return None if click is None else click_played_at(click, level_db)

    def drive_for(
        self, felt: Sequence[str | complex], quiet: Sequence[str | complex] = (), level_db: float = DEFAULT_LEVEL_DB
    ) -> "SteadyDrive":
        """Steady drive solved for fingers at these positions, given as in `click_for`; loads compiled kernels.

        Raises PlacementError, and SteadyError where no finger is felt.
        """
        placement = Placement.named(self.device, felt, quiet)
        return self._steady.solve(placement.position_m, placement.is_felt, level_db)

    @cached_property
    def _steady(self) -> "SteadySolver":
        from engine.steady.steady_solver import SteadySolver  # it brings a compiler, which few who open a table need

        return SteadySolver(self.device, self.modes)

    def localized_factor(self, zones: Sequence[str], pair: int = 0) -> Values:
        """Kinetic-energy share of `zones` together: (frequency_1, frequency_2, amplitude_1, amplitude_2)."""
        return self._combine("localized_factor", zones, pair, np.sum)

    def peak_acceleration(self, zones: Sequence[str], pair: int = 0) -> Values:
        """Greatest peak acceleration in `zones`, m/s^2: (frequency_1, frequency_2, amplitude_1, amplitude_2)."""
        return self._combine("peak_acceleration", zones, pair, np.max)

    def dead_spot(self, zones: Sequence[str], pair: int = 0) -> Values:
        """Least peak acceleration in `zones`, m/s^2: (frequency_1, frequency_2, amplitude_1, amplitude_2)."""
        return self._combine("dead_spot", zones, pair, np.min)

    def _combine(self, name: str, zones: Sequence[str], pair: int, combine: Any) -> Values:
        indices = sorted({self.device.zone_index(zone) for zone in _listed(zones)})
        if not indices:
            raise TableError(f"{self.path}: name at least one zone")
        if "sweep" not in self._file.groups:
            raise TableError(f"{self.path}: {self.no_sweep_text}")
        stored = self._file.groups["sweep"].variables[name]
        if not 0 <= pair < stored.shape[0]:
            raise TableError(f"{self.path}: there is no actuator pair {pair}; there are {stored.shape[0]}")
        values = np.stack([np.asarray(stored[pair, :, :, :, zone]) for zone in indices])
        return np.moveaxis(combine(values, axis=0), -1, 1)


def _listed(zones: Sequence[str]) -> Sequence[str]:
    """Refuse a text in place of a list of names: "III" would be taken for three times "I"."""
    if isinstance(zones, str):
        raise TableError(f"zones {zones!r}: is one text; give a list of names, such as [{zones!r}]")
    return zones


def _stale_text(own: Device, wanted: Device | None) -> str:
    """Why the table of `own` does not do for `wanted`; without one, the table contradicts itself."""
    if wanted is not None and wanted.name != own.name:
        return f"is a table of {own.name!r}, not of {wanted.name!r}; name the table of {wanted.name!r}, or build it"
    return f"is stale: it was built for another state of {own.name!r}; build it again"


def _read_inside(path: Path, sealed: bool, verify: bool) -> _LiveParts:
    """What is in a table whose attributes, links and arrays are sound; nothing outside the file is opened."""
    with h5py.File(path, "r") as file:
        _check_format(path, file)
        if not sealed:
            raise TableError(f"{path}: is corrupted: it was changed after it was built; build it again")
        groups = sound_arrays(path, file, path.stat().st_size)
        device = Device.parse(str(file.attrs["device_description"]), f"{path}: device_description")
        check_values(path, groups, device, with_sweeps=verify)
        rows = BestRows([], device.limits.amplitude)
        if "best_rows" in groups:
            rows = read_best_rows(groups["best_rows"], device)
        corner_m, pitch_m = device.surface.corner_m, float(file.attrs["click_pitch_m"][0])
        if "clicks" in groups:
            clicks = read_clicks(groups["clicks"], corner_m, float(file.attrs["click_tolerance_m"][0]))
        else:
            clicks = Clicks.of(Places.every(corner_m, pitch_m), [])
        is_packed = IS_SHIPPED in file.attrs and "modes" not in groups
        return device, rows, clicks, None if is_packed else read_modes(groups["modes"], device)


def _as_table_error(path: Path, error: Exception) -> TableError:
    if isinstance(error, TableError):
        return error
    return TableError(f"{path}: is corrupted ({error!r}); build it again")


def _check_format(path: Path, file: h5py.File) -> None:
    if file.attrs.get("format") != FORMAT:
        raise TableError(f"{path}: is a NetCDF file, but not a table of tactable")
    revision = int(np.ravel(file.attrs["format_revision"])[0])
    if revision > FORMAT_REVISION:
        raise TableError(f"{path}: has format revision {revision}, tactable reads {FORMAT_REVISION}; update it")
    if revision < FORMAT_REVISION:
        raise TableError(
            f"{path}: has format revision {revision} of an earlier version of tactable, this program reads "
            f"{FORMAT_REVISION}; build it again"
        )
