"""The table file (tables/FORMAT.md): written beside its target and renamed, opened verified, never half believed."""

import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.device_file import parse_device
from engine.entry import DEFAULT_LEVEL_DB, Entry, WorstCase, ZonePromise, played_at
from engine.zones import ZoneState, state_index

FORMAT = "tactable table"
FORMAT_REVISION = 2
_READ_BYTES = 1 << 24
_HDF5_SIGNATURE, _HDF5_SUPERBLOCK, _HDF5_END = b"\x89HDF\r\n\x1a\n", 0, 40  # superblock 0: end of file at byte 40
_SEAL, _SEAL_MAGIC = struct.Struct("<12sI"), b"tactable end"

Values = NDArray[Any]


class TableError(Exception):
    """A table that cannot be used: missing, truncated, corrupted, foreign, newer or stale; the message says which."""


@dataclass(frozen=True)
class Variable:
    """A named array of a group: dimension names, SI unit ("1" for a plain number), one sentence on what it is."""

    name: str
    dimensions: tuple[str, ...]
    unit: str
    meaning: str


class TableWriter:
    """Writes a table beside `path` and renames it there on a clean exit; any exception leaves nothing behind."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        self._checksums: dict[str, int] = {}

    def __enter__(self) -> "TableWriter":
        if not self.path.parent.is_dir():
            raise TableError(f"{self.path.parent}: no such folder; create it or choose another output")
        try:
            self._file = h5netcdf.File(self._partial, "w", track_order=True)
        except OSError as error:
            raise TableError(f"{self.path}: cannot be written there: {error}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.close()
            if kind is None:
                _verify_arrays(self._partial, self._checksums)
                _append_seal(self._partial)
                self._partial.replace(self.path)
        finally:
            self._partial.unlink(missing_ok=True)

    def describe(self, attributes: Mapping[str, str | int | float]) -> None:
        """Attributes of the whole table."""
        self._file.attrs.update({"format": FORMAT, "format_revision": FORMAT_REVISION, **attributes})

    def write(self, group: str, variable: Variable, values: Values | Sequence[str]) -> None:
        """Write one array; dimensions are made from the first array that uses them."""
        data = np.asarray(values, dtype=object if _is_text(values) else None, order="C")
        stream = self.open_stream(group, variable, data.shape, "str" if _is_text(values) else data.dtype)
        stream.append(data)
        stream.close()

    def open_stream(self, group: str, variable: Variable, shape: tuple[int, ...], dtype: Any) -> "VariableStream":
        """Begin an array that is written in pieces; dimensions are made from the first array that uses them."""
        where = self._file.groups[group] if group in self._file.groups else self._file.create_group(group)
        for name, size in zip(variable.dimensions, shape, strict=True):
            if name not in where.dimensions:
                where.dimensions[name] = size
        target = where.create_variable(
            variable.name, variable.dimensions, h5py.string_dtype() if dtype == "str" else dtype
        )
        target.attrs["units"] = variable.unit
        target.attrs["long_name"] = variable.meaning
        return VariableStream(f"{group}/{variable.name}", target, shape, self._checksums)


class VariableStream:
    """One array being written, whole or in pieces along its second axis, in C order."""

    def __init__(self, name: str, target: Any, shape: tuple[int, ...], checksums: dict[str, int]) -> None:
        self._name, self._target, self._shape, self._checksums = name, target, shape, checksums
        self._size = math.prod(shape)
        self._done, self._checksum = 0, 0

    def append(self, piece: Values) -> None:
        """Write the whole array, or the next rows of its second axis, which may not pass the end of the first's."""
        self._checksum = zlib.crc32(_bytes_of(piece), self._checksum)
        if piece.size == self._size:
            self._target[...] = piece.reshape(self._shape)
        else:
            row, column = divmod(self._done // math.prod(self._shape[2:]), self._shape[1])
            self._target[row, column : column + len(piece)] = piece.reshape(-1, *self._shape[2:])
        self._done += piece.size

    def close(self) -> None:
        """Note the checksum; raises TableError if elements are missing."""
        if self._done != self._size:
            raise TableError(f"{self._name}: {self._done} elements of an array of shape {self._shape} were written")
        self._target.attrs["crc32"] = np.uint32(self._checksum)
        self._checksums[self._name] = self._checksum


class Table:
    """An open table: its device, its entries, and views of the sweep for any zone combination."""

    def __init__(self, path: Path, file: h5netcdf.File) -> None:
        self.path = path
        self._file = file
        self.attributes: dict[str, Any] = dict(file.attrs)
        self.device: Device = parse_device(str(self.attributes["device_description"]), f"{path}: device_description")
        self.fingerprint = str(self.attributes["device_fingerprint"])
        self.entries: tuple[Entry, ...] = tuple(_read_entries(file.groups["entries"], self.device))
        self.levels_db = tuple(dict.fromkeys(entry.wanted_level_db for entry in self.entries))
        """Levels that have entries, rising; the last is infinite: full scale."""
        self._by_state: dict[int, list[Entry]] = {}  # by rising level
        for entry in self.entries:
            self._by_state.setdefault(entry.index, []).append(entry)

    def __enter__(self) -> "Table":
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; entries and device stay usable."""
        self._file.close()

    def values(self, group: str, name: str) -> Values:
        """One whole array by its group and name, such as "responses" and "frequency"."""
        return np.asarray(self._file.groups[group].variables[name][...])

    def entry_for(self, felt: Sequence[str], quiet: Sequence[str] = (), level_db: float = DEFAULT_LEVEL_DB) -> Entry:
        """Entry of the state with these zones (names) felt and quiet and the others free, at `level_db`.

        Between tabulated levels: the next lower drive, played louder, or else the next higher one, softer. Raises
        DeviceError for an unknown zone, TableError for a zone that is both and for a state the table does not hold.
        """
        index = state_index(self.states_of(felt, quiet))
        entry = self.entry_at(index, level_db)
        if entry is None:
            raise TableError(
                f"{self.path}: has no entry for felt zones {', '.join(felt)!r} and quiet {', '.join(quiet)!r}"
            )
        return entry

    def states_of(self, felt: Sequence[str], quiet: Sequence[str]) -> tuple[ZoneState, ...]:
        """State of every zone; raises DeviceError for an unknown zone, TableError for one that is both."""
        states = [ZoneState.FREE] * len(self.device.zones)
        for name in quiet:
            states[self.device.zone_index(name)] = ZoneState.QUIET
        for name in felt:
            zone = self.device.zone_index(name)
            if states[zone] is ZoneState.QUIET:
                raise TableError(f"zone {name} can't be felt and quiet: name it once")
            states[zone] = ZoneState.FELT
        return tuple(states)

    def entry_at(self, state: int, level_db: float) -> Entry | None:
        """Entry of a state (engine.zones.state_index) at a level, None where there is none."""
        if math.isnan(level_db):
            raise TableError(
                "a level that is no number; give dB above the detection threshold, infinite for full scale"
            )
        entries = self._by_state.get(state)
        return None if entries is None else played_at(entries, level_db, self.device.limits.amplitude)

    def entries_at(self, level_db: float) -> tuple[Entry, ...]:
        """Entry of every state at one level."""
        limit = self.device.limits.amplitude
        return tuple(played_at(entries, level_db, limit) for entries in self._by_state.values())

    def entries_of(self, tabulated_db: float) -> tuple[Entry, ...]:
        """Entries of one tabulated level as they are."""
        return tuple(entry for entry in self.entries if entry.wanted_level_db == tabulated_db)

    def localized_factor(self, zones: Sequence[str], pair: int = 0) -> Values:
        """Share of kinetic energy of `zones` together: (frequency_1, frequency_2, amplitude_1, amplitude_2)."""
        return self._combine("localized_factor", zones, pair, np.sum)

    def peak_acceleration(self, zones: Sequence[str], pair: int = 0) -> Values:
        """Greatest peak acceleration in `zones`, m/s^2: (frequency_1, frequency_2, amplitude_1, amplitude_2)."""
        return self._combine("peak_acceleration", zones, pair, np.max)

    def dead_spot(self, zones: Sequence[str], pair: int = 0) -> Values:
        """Least peak acceleration in `zones`, m/s^2: (frequency_1, frequency_2, amplitude_1, amplitude_2)."""
        return self._combine("dead_spot", zones, pair, np.min)

    def _combine(self, name: str, zones: Sequence[str], pair: int, combine: Any) -> Values:
        indices = sorted({self.device.zone_index(zone) for zone in zones})
        if not indices:
            raise TableError(f"{self.path}: name at least one zone")
        if "sweep" not in self._file.groups:
            raise TableError(f"{self.path}: has no sweep of actuator pairs: {self.device.name} has one actuator")
        stored = self._file.groups["sweep"].variables[name]
        if not 0 <= pair < stored.shape[0]:
            raise TableError(f"{self.path}: there is no actuator pair {pair}; there are {stored.shape[0]}")
        values = np.stack([np.asarray(stored[pair, :, :, :, zone]) for zone in indices])
        return np.moveaxis(combine(values, axis=0), -1, 1)


def open_table(
    path: Path, *, device: Device | None = None, code_fingerprint: str | None = None, verify: bool = True
) -> Table:
    """Open and verify a table; raises TableError if it is unusable or does not belong to `device` or the code."""
    sealed = _check_bytes(path, verify)
    try:
        file = h5netcdf.File(path, "r", decode_vlen_strings=True)
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        raise TableError(f"{path}: is corrupted ({error}); build it again") from error
    try:
        _check_format(path, file)
        if not sealed:
            raise TableError(f"{path}: is corrupted: it was changed after it was built; build it again")
        table = Table(path, file)
        if table.device.fingerprint != table.fingerprint or (device and device.fingerprint != table.fingerprint):
            name = device.name if device else table.device.name
            raise TableError(f"{path}: is stale: it was built for another state of {name!r}; build it again")
        if code_fingerprint and table.attributes["code_fingerprint"] != code_fingerprint:
            raise TableError(f"{path}: is stale: it was built by another version of the code; build it again")
    except BaseException as error:
        file.close()
        if isinstance(error, KeyError | ValueError | OSError | RuntimeError | TypeError):
            raise TableError(f"{path}: is corrupted ({error}); build it again") from error
        raise
    return table


def _check_bytes(path: Path, verify: bool) -> bool:
    """Whether the file is sealed; refuses broken ones before HDF5 parses them, which some crash or send in circles."""
    if not path.is_file():
        raise TableError(f"{path}: there is no such table; `tactable build DEVICE -o {path.name}` makes one")
    with path.open("rb") as file:
        head = file.read(_HDF5_END + 8)
    if not head.startswith(_HDF5_SIGNATURE) or len(head) < _HDF5_END + 8:
        raise TableError(f"{path}: is not a table of tactable (not a NetCDF-4 file)")
    seal, size = _read_seal(path), path.stat().st_size
    if seal is None and size != int.from_bytes(head[_HDF5_END:], "little") and head[8] == _HDF5_SUPERBLOCK:
        raise TableError(f"{path}: is truncated; build it again")
    if verify and seal is not None and seal != _file_checksum(path, size - _SEAL.size):
        raise TableError(f"{path}: is corrupted: it fails its checksum; build it again")
    return seal is not None


def _append_seal(path: Path) -> None:
    """Close the file with a magic and the CRC-32 of all before it, which HDF5 does not read; then to the disk."""
    checksum = _file_checksum(path, path.stat().st_size)
    with path.open("ab") as file:
        file.write(_SEAL.pack(_SEAL_MAGIC, checksum))
        file.flush()
        os.fsync(file.fileno())


def _read_seal(path: Path) -> int | None:
    """The sealed checksum; None where there is no seal."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _SEAL.size))
        last = file.read()
    if len(last) < _SEAL.size or not last.startswith(_SEAL_MAGIC):
        return None
    return int(_SEAL.unpack(last)[1])


def _file_checksum(path: Path, size: int) -> int:
    checksum = 0
    with path.open("rb") as file:
        while size > 0 and (piece := file.read(min(size, _READ_BYTES))):
            checksum = zlib.crc32(piece, checksum)
            size -= len(piece)
    return checksum


def _check_format(path: Path, file: h5netcdf.File) -> None:
    if file.attrs.get("format") != FORMAT:
        raise TableError(f"{path}: is a NetCDF file, but not a table of tactable")
    revision = int(file.attrs["format_revision"])
    if revision > FORMAT_REVISION:
        raise TableError(
            f"{path}: has format revision {revision}, this program reads up to {FORMAT_REVISION}; update tactable"
        )


def _verify_arrays(path: Path, checksums: Mapping[str, int]) -> None:
    """Read every array back and compare it with the checksum of what was to be written."""
    with h5py.File(path, "r") as file:  # the same file a layer below: h5netcdf takes 5 ms for each variable it opens
        for name, checksum in checksums.items():
            if _array_checksum(file[name]) != checksum:
                raise TableError(f"{path}: {name} was not written as it was computed: is the disk full or failing?")


def _array_checksum(variable: h5py.Dataset) -> int:
    """CRC-32 of the array, read in pieces of bounded size along its first two axes."""
    if variable.ndim < 2 or variable.nbytes <= _READ_BYTES:
        return zlib.crc32(_bytes_of(np.asarray(variable[...])))
    checksum, rows = 0, variable.shape[1]
    step = max(1, _READ_BYTES * variable.shape[0] * rows // variable.nbytes)
    for first in range(variable.shape[0]):
        for start in range(0, rows, step):
            checksum = zlib.crc32(_bytes_of(np.asarray(variable[first, start : start + step])), checksum)
    return checksum


def _is_text(values: object) -> bool:
    if isinstance(values, np.ndarray):
        return bool(values.dtype.kind == "O")
    return isinstance(values, Sequence) and isinstance(values[0], str)


def _bytes_of(piece: Values) -> bytes | memoryview:
    if piece.dtype.kind == "O":
        return "\0".join(part if isinstance(part, str) else part.decode() for part in piece.ravel()).encode()
    return np.ascontiguousarray(piece).reshape(-1).view(np.uint8).data


_ROW = ("level", "state")
ENTRY_VARIABLES = {
    "frequencies_hz": Variable("drive_frequency", (*_ROW, "actuator"), "Hz", "frequency of each actuator"),
    "amplitudes": Variable("drive_amplitude", (*_ROW, "actuator"), "1", "amplitude as a fraction of full scale"),
    "phases_rad": Variable("drive_phase", (*_ROW, "actuator"), "rad", "phase of each actuator"),
    "level_db": Variable("felt_level", _ROW, "dB", "sensation level of the weakest felt finger"),
    "achieved": Variable("achieved", _ROW, "1", "1: the wanted level is reached in every felt zone"),
    "contrast_db": Variable("contrast", _ROW, "dB", "weakest felt over strongest quiet finger; NaN: nothing is quiet"),
    "expected_contrast_db": Variable(
        "expected_contrast", _ROW, "dB", "the same, levels averaged in power over the fingers looked at"
    ),
    "localized_factor": Variable("localized_factor", _ROW, "1", "share of the felt zones, paper eq. (10)"),
    "objective": Variable("objective", _ROW, "1", "what was maximised above the level"),
    "upper_bound": Variable("upper_bound", _ROW, "1", "no drive does better: a share, or dB, as the objective is"),
    "optimality_gap_db": Variable("optimality_gap", _ROW, "dB", "what the bound leaves open"),
    "t90_s": Variable("rise_time", _ROW, "s", "t90 of the slowest felt finger"),
    "family": Variable("family", _ROW, "1", "single tone, coherent, two tones or several tones"),
    "limited_by": Variable("limited_by", _ROW, "1", "what limited the drive"),
}
WORST_VARIABLES = {
    "level_db": Variable("worst_felt_level", _ROW, "dB", "weakest felt finger of all that were looked at"),
    "quiet_level_db": Variable("worst_quiet_level", _ROW, "dB", "strongest quiet finger of all; NaN: none is quiet"),
    "contrast_db": Variable("worst_contrast", _ROW, "dB", "least contrast over the fingers; NaN: none is quiet"),
    "localized_factor": Variable("worst_localized_factor", _ROW, "1", "least over the fingers"),
    "t90_s": Variable("worst_rise_time", _ROW, "s", "greatest over the fingers"),
}
_ZONE = (*_ROW, "zone")
_END = (*_ZONE, "end")
ZONE_VARIABLES = {
    "state": Variable("zone_state", _ZONE, "1", "0 free, 1 quiet, 2 felt"),
    "share": Variable("share", _ZONE, "1", "localized factor of the zone"),
    "share_range": Variable("share_range", _END, "1", "least and greatest over the fingers looked at"),
    "peak_acceleration_m_per_s2": Variable("peak_acceleration", _ZONE, "m s-2", "greatest in the zone"),
    "peak_acceleration_range_m_per_s2": Variable(
        "peak_acceleration_range", _END, "m s-2", "least and greatest over the fingers looked at"
    ),
    "peak_position_m": Variable("peak_position", _ZONE, "m", "where it is, from the bar's start"),
    "dead_acceleration_m_per_s2": Variable("dead_spot", _ZONE, "m s-2", "least in the zone"),
    "dead_position_m": Variable("dead_position", _ZONE, "m", "where it is, from the bar's start"),
    "acceleration_at_finger_m_per_s2": Variable(
        "acceleration_at_finger", _ZONE, "m s-2", "under the finger; NaN: no finger"
    ),
    "sensation_level_db": Variable("sensation_level", _ZONE, "dB", "above the detection threshold; NaN: no finger"),
    "sensation_level_range_db": Variable(
        "sensation_level_range", _END, "dB", "least and greatest over the fingers looked at; NaN: no finger"
    ),
}


def write_entries(writer: TableWriter, entries: Sequence[Entry], device: Device) -> None:
    """Write the entries group. The entries are every state at the first level, in the same order at the next ..."""
    levels_db = list(dict.fromkeys(entry.wanted_level_db for entry in entries))
    states = [entry.index for entry in entries[: len(entries) // len(levels_db)]]
    writer.write("entries", _names("actuator"), [actuator.name for actuator in device.actuators])
    writer.write("entries", _names("zone"), [zone.name for zone in device.zones])
    writer.write("entries", Variable("end", ("end",), "1", "of a range"), ["least", "greatest"])
    level = Variable("level", ("level",), "dB", "wanted sensation level of every felt finger; infinite: full scale")
    writer.write("entries", level, np.array(levels_db, dtype=np.float64))
    index = Variable("state", ("state",), "1", "sum of zone state times 3**zone")
    writer.write("entries", index, np.array(states, dtype=np.int64))
    rows = (len(levels_db), len(states))
    for key, variable in ENTRY_VARIABLES.items():
        _write_column(writer, variable, [getattr(entry, key) for entry in entries], rows)
    for key, variable in WORST_VARIABLES.items():
        _write_column(writer, variable, [getattr(entry.worst_case, key) for entry in entries], rows)
    for key, variable in ZONE_VARIABLES.items():
        _write_column(writer, variable, [[getattr(zone, key) for zone in entry.zones] for entry in entries], rows)


def _write_column(writer: TableWriter, variable: Variable, column: list[Any], rows: tuple[int, int]) -> None:
    if _is_text(column):
        writer.write("entries", variable, np.array(column, dtype=object).reshape(rows))
        return
    if variable.dimensions[-1] == "end":
        column = [[(np.nan, np.nan) if value is None else value for value in row] for row in column]
    values = np.array(column, dtype=np.float64)  # None becomes NaN
    writer.write("entries", variable, values.reshape(*rows, *values.shape[1:]))


def _names(what: str) -> Variable:
    return Variable(what, (what,), "1", f"name of the {what}")


def _read_entries(group: Any, device: Device) -> Iterator[Entry]:
    def columns(variables: Mapping[str, Variable]) -> dict[str, list[Any]]:
        return {key: _read_column(group, variable) for key, variable in variables.items()}

    levels_db = [float(level_db) for level_db in group.variables["level"][...]]
    own, worst, zones = (columns(part) for part in (ENTRY_VARIABLES, WORST_VARIABLES, ZONE_VARIABLES))
    states = len(own["achieved"]) // len(levels_db)
    for row in range(len(own["achieved"])):
        values: dict[str, Any] = {key: column[row] for key, column in own.items()}
        values |= {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
        yield Entry(
            **values | {"achieved": bool(values["achieved"])},
            wanted_level_db=levels_db[row // states],
            worst_case=WorstCase(**{key: column[row] for key, column in worst.items()}),
            zones=tuple(_read_zone(zones, row, z, zone.name) for z, zone in enumerate(device.zones)),
        )


def _read_column(group: Any, variable: Variable) -> list[Any]:
    """One value an entry; NaN, which stands for absence, as None."""
    values = np.asarray(group.variables[variable.name][...])
    values = values.reshape(-1, *values.shape[2:])
    if values.dtype.kind == "f":
        values = np.where(np.isnan(values), None, values)  # type: ignore[call-overload]  # an array of objects
    rows: list[Any] = values.tolist()
    return rows


def _read_zone(zones: Mapping[str, list[Any]], row: int, zone: int, name: str) -> ZonePromise:
    figures = {key: column[row][zone] for key, column in zones.items()}
    ranges = {key: _range(value) for key, value in figures.items() if isinstance(value, list)}
    return ZonePromise(**figures | ranges | {"name": name, "state": ZoneState(int(figures["state"]))})


def _range(ends: list[float | None]) -> tuple[float, float] | None:
    least, greatest = ends
    return None if least is None or greatest is None else (least, greatest)
