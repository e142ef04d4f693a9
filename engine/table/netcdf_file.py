"""Writes and checks table files: written beside the target, verified, sealed by a checksum, then renamed into place.

A NetCDF-4 file is HDF5, and HDF5 libraries crash or loop on some damaged files. So the bytes are checked before they
are parsed: the signature, the length, and a seal (CRC-32 of everything before it) that is appended after the HDF5 data,
where its readers ignore it.
"""

import io
import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from base.arrays import Points
from base.files import partial_path, unwritable, written_path
from engine.table.history import remove_leftovers, replace_table
from engine.table.schema import TableError

FORMAT = "tactable table"
FORMAT_REVISION = 8  # tables/FORMAT.md; raise it when an older reader would misread
_READ_BYTES = 1 << 24  # 16 MiB at a time: tables of gigabytes are copied and checked in little memory
_HDF5_SIGNATURE, _HDF5_SUPERBLOCK, _HDF5_END = b"\x89HDF\r\n\x1a\n", 0, 40  # superblock 0: end of file at byte 40
_SEAL, _SEAL_MAGIC = struct.Struct("<12sI"), b"tactable end"

ACROSS = "_across"  # ends the name of the array that holds the second coordinate of a plate's points
Values = NDArray[Any]


@dataclass(frozen=True)
class Variable:
    """A named array of a group: dimension names, SI unit ("1" for a plain number), one sentence on what it is."""

    name: str
    dimensions: tuple[str, ...]
    unit: str
    meaning: str
    scale: float | None = None  # what one count stands for, where counts are stored: readers of NetCDF multiply by it

    @classmethod
    def names(cls, what: str) -> "Variable":
        """The names along the dimension `what`."""
        return cls(what, (what,), "1", f"name of the {what}")


class TableWriter:
    """Writes a table beside `path` and renames it there on a clean exit; any exception leaves nothing behind.

    Where `path` is a symbolic link, the file that it leads to is replaced, and the link stays.

    `check` gets the finished file before it takes its place, and may refuse it by an exception. What was at `path` is
    kept (engine.table.history), unless this table only `completes` it: then the one before that stays the one kept.
    """

    def __init__(self, path: Path, check: Callable[[Path], None] | None = None, *, completes: bool = False) -> None:
        self.path = written_path(path)
        self._check, self._completes = check, completes
        self._partial = partial_path(self.path)
        self._checksums: dict[str, int] = {}

    def __enter__(self) -> "TableWriter":
        if not self.path.parent.is_dir():
            raise TableError(f"{self.path.parent}: no such folder; create it or choose another output")
        if self.path.exists() and not self.path.is_file():
            raise TableError(f"{self.path}: is not a plain file, and is not replaced; choose another output")
        remove_leftovers(self.path)
        self._partial.unlink(missing_ok=True)  # of a killed process that had the number of this one, as in containers
        try:
            self._spool = SpoolFile(self._partial)
        except OSError as error:
            raise self._unwritable(error) from error
        self._inside = h5py.File(self._spool, "w", track_order=True)
        self._file = h5netcdf.File(self._inside, "w", track_order=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, *unused: object) -> None:
        try:
            with self._spool, self._inside:
                self._file.close()
            if kind is None:
                self._spool.check()
                _verify_arrays(self._partial, self._checksums)
                _append_seal(self._partial)
                if self._check is not None:
                    self._check(self._partial)
                replace_table(self._partial, self.path, keep=not self._completes)
        except OSError as disk:
            raise self._unwritable(disk) from disk
        finally:
            self._partial.unlink(missing_ok=True)

    def _unwritable(self, error: OSError) -> TableError:
        return TableError(str(unwritable(self.path, error)))

    def describe(self, attributes: Mapping[str, str | int | float]) -> None:
        """Attributes of the whole table."""
        self._file.attrs.update({"format": FORMAT, "format_revision": FORMAT_REVISION, **attributes})

    def write(self, group: str, variable: Variable, values: Values | Sequence[str]) -> None:
        """Write one array; dimensions are made from the first array that uses them."""
        data = np.asarray(values, dtype=object if is_text(values) else None, order="C")
        stream = self.open_stream(group, variable, data.shape, "str" if is_text(values) else data.dtype)
        stream.append(data)
        stream.close()

    def write_points(self, group: str, variable: Variable, points: Points) -> None:
        """Write points as an array of distances along the surface, and for a plate one of those across it."""
        self.write(group, variable, points.real)
        if np.iscomplexobj(points):
            across = replace(variable, name=f"{variable.name}{ACROSS}", meaning=f"{variable.meaning}, across the plate")
            self.write(group, across, points.imag)

    def copy(self, group: str, source: Any) -> None:
        """Write an open group of another table as it is there, in bounded memory; its arrays are checked as any."""
        for name, variable in source.variables.items():
            scale = variable.attrs.get("scale_factor")
            like = Variable(
                name,
                tuple(variable.dimensions),
                str(variable.attrs["units"]),
                str(variable.attrs["long_name"]),
                None if scale is None else float(scale),
            )
            shape = tuple(variable.shape)
            if math.prod(shape) * variable.dtype.itemsize <= _READ_BYTES or len(shape) < 2:
                values = np.asarray(variable[...])
                self.write(group, like, values.astype(object) if values.dtype.kind in "SU" else values)
                continue
            stream = self.open_stream(group, like, shape, variable.dtype)
            for piece in pieces(variable):
                stream.append(piece)
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
        if variable.scale is not None:
            target.attrs["scale_factor"] = variable.scale
        return VariableStream(f"{group}/{variable.name}", target, shape, self._checksums, self._check_disk)

    def _check_disk(self) -> None:
        try:
            self._spool.check()
        except OSError as error:
            raise self._unwritable(error) from error


class VariableStream:
    """One array being written, whole or in pieces along its second axis, in C order."""

    def __init__(
        self, name: str, target: Any, shape: tuple[int, ...], checksums: dict[str, int], check_disk: Callable[[], None]
    ) -> None:
        self._name, self._target, self._shape, self._checksums = name, target, shape, checksums
        self._check_disk = check_disk
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
        self._check_disk()

    def close(self) -> None:
        """Note the checksum; raises TableError if elements are missing."""
        if self._done != self._size:
            raise TableError(f"{self._name}: {self._done} elements written; expected {self._size}, shape {self._shape}")
        self._target.attrs["crc32"] = np.uint32(self._checksum)
        self._checksums[self._name] = self._checksum


def check_bytes(path: Path, verify: bool) -> bool:
    """Whether the file is sealed. Raises TableError for damaged files, before HDF5 parses them."""
    if not path.is_file():
        raise TableError(f"{path}: there is no such table; `tactable build DEVICE -o {path.name}` makes one")
    with path.open("rb") as file:
        head = file.read(_HDF5_END + 8)
    if not head.startswith(_HDF5_SIGNATURE) or len(head) < _HDF5_END + 8:
        raise TableError(f"{path}: is not a table of tactable (not a NetCDF-4 file)")
    seal, size = _read_seal(path), path.stat().st_size
    if seal is None and size != int.from_bytes(head[_HDF5_END:], "little") and head[8] == _HDF5_SUPERBLOCK:
        raise TableError(f"{path}: is truncated; build it again")
    if verify and seal is not None and seal != file_checksum(path, size - _SEAL.size):
        raise TableError(f"{path}: is corrupted: it fails its checksum; build it again")
    return seal is not None


def _append_seal(path: Path) -> None:
    """Close the file with a magic and the CRC-32 of all before it, which HDF5 does not read."""
    checksum = file_checksum(path)
    with path.open("ab") as file:
        file.write(_SEAL.pack(_SEAL_MAGIC, checksum))


def _read_seal(path: Path) -> int | None:
    """The sealed checksum; None where there is no seal."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _SEAL.size))
        last = file.read()
    if len(last) < _SEAL.size or not last.startswith(_SEAL_MAGIC):
        return None
    return int(_SEAL.unpack(last)[1])


def file_checksum(path: Path, size: float = math.inf) -> int:
    """CRC-32 of the first `size` bytes of a file."""
    checksum = 0
    with path.open("rb") as file:
        while size > 0 and (piece := file.read(int(min(size, _READ_BYTES)))):
            checksum = zlib.crc32(piece, checksum)
            size -= len(piece)
    return checksum


def _verify_arrays(path: Path, checksums: Mapping[str, int]) -> None:
    """Read every array back and compare it with the checksum of what was to be written."""
    with h5py.File(path, "r") as file:  # the same file a layer below: h5netcdf takes 5 ms for each variable it opens
        for name, checksum in checksums.items():
            found = 0
            for piece in pieces(file[name]):
                found = zlib.crc32(_bytes_of(piece), found)
            if found != checksum:
                raise TableError(f"{path}: {name} was not written as it was computed: is the disk full or failing?")


def read_points(arrays: Mapping[str, h5py.Dataset], name: str) -> Points:
    """Points of a group with these open arrays, as `write_points` wrote them."""
    along, across = np.asarray(arrays[name][...]), arrays.get(f"{name}{ACROSS}")
    return along if across is None else along + 1j * np.asarray(across[...])


def pieces(variable: Any) -> Iterator[Values]:
    """The values of an open array in C order, in pieces of bounded size along its first two axes."""
    shape, item_bytes = variable.shape, variable.dtype.itemsize
    if len(shape) < 2 or math.prod(shape) * item_bytes <= _READ_BYTES:
        yield np.asarray(variable[...])
        return
    step = max(1, _READ_BYTES // (math.prod(shape[2:]) * item_bytes))
    for row in range(shape[0]):
        for start in range(0, shape[1], step):
            yield np.asarray(variable[row, start : start + step])


def is_text(values: object) -> bool:
    """Whether an array is written as strings."""
    if isinstance(values, np.ndarray):
        return bool(values.dtype.kind == "O")
    return isinstance(values, Sequence) and isinstance(values[0], str)


def _bytes_of(piece: Values) -> bytes | memoryview:
    if piece.dtype.kind == "O":
        return "\0".join(part if isinstance(part, str) else part.decode() for part in piece.ravel()).encode()
    return np.ascontiguousarray(piece).reshape(-1).view(np.uint8).data


class SpoolFile(io.RawIOBase):
    """A new file for HDF5 to write to that never fails; `check` raises the first OSError of the disk that it met.

    HDF5 ends the process by a segmentation fault when it closes a file that it could not write. So it is never told.
    After the first error, what it writes is kept in memory and read back from there, until the caller sees the error
    and gives the file up. Little is written in between: `check` is called after every piece of an array.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("x+b", buffering=0)
        self._error: OSError | None = None
        self._place, self._end = 0, 0
        self._kept: list[tuple[int, bytes]] = []  # place and content of what the disk did not take, in order

    def check(self) -> None:
        """Raise the first error of the disk."""
        if self._error is not None:
            raise self._error

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a place."""
        self._place = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._place, io.SEEK_END: self._end}[whence]
        return self._place

    def tell(self) -> int:
        """The present place."""
        return self._place

    def write(self, data: "bytes | bytearray | memoryview") -> int:  # type: ignore[override]  # all that HDF5 gives
        """Take all of `data`, on the disk or in memory."""
        view = memoryview(data).cast("B")
        done = 0
        while self._error is None and done < len(view):
            try:
                self._file.seek(self._place + done)
                done += self._file.write(view[done:]) or 0
            except OSError as error:
                self._error = error
        if done < len(view):
            self._kept.append((self._place + done, bytes(view[done:])))
        self._place += len(view)
        self._end = max(self._end, self._place)
        return len(view)

    def readinto(self, buffer: "bytearray | memoryview") -> int:  # type: ignore[override]  # all that HDF5 gives
        """Fill `buffer` from the disk and from what is kept in memory; what was never written is 0."""
        view = memoryview(buffer).cast("B")
        size = max(0, min(len(view), self._end - self._place))
        self._file.seek(self._place)
        content = bytearray(self._file.read(size) or b"").ljust(size, b"\0")
        for place, kept in self._kept:
            first, last = max(place, self._place), min(place + len(kept), self._place + size)
            if first < last:
                content[first - self._place : last - self._place] = kept[first - place : last - place]
        view[:size] = content
        self._place += size
        return size

    def truncate(self, size: int | None = None) -> int:
        """Give the file the length that HDF5 wants."""
        self._end = self._place if size is None else size
        if self._error is None:
            try:
                self._file.truncate(self._end)
            except OSError as error:
                self._error = error
        return self._end

    def flush(self) -> None:
        """Nothing is buffered."""

    def close(self) -> None:
        """Close the file on the disk."""
        self._file.close()
        super().close()
