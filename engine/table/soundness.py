"""Checks what is in a table file once, when it is opened: nothing lies outside the file, every array is what is read.

The seal of a table (engine.table.netcdf_file) finds damage. It does not find malice, since whoever changes a file can
seal it again. HDF5 offers such a file three ways to make a reader open another file: external links, external raw
storage and virtual datasets. All three are refused before any of them is followed. Then the kind, the shape and the
values of every array are compared with the declaration (engine.table.schema), so that readers of best rows and clicks
need no checks of their own. Large arrays are read in pieces of bounded size.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.table.netcdf_file import pieces, read_points
from engine.table.schema import (
    FIXED_SIZES,
    REAL_ATTRIBUTES,
    SCHEMA,
    TEXT_ATTRIBUTES,
    WHOLE_ATTRIBUTES,
    ArrayKind,
    Kind,
    TableError,
)
from engine.touch.placement import Places

_ROUNDING_M = 1e-9
_FEWEST_PLACES = 4  # values between are cubic through four
_SPREADS = 5  # nominal plant, three percentiles, and the worst
_DIMENSION_ONLY = b"This is a netCDF dimension but not a netCDF variable"
_NAMES = ("actuator", "zone")
_ROWS = ("best_rows", "clicks")

Arrays = Mapping[str, h5py.Dataset]  # of a group by name, open: to open one again takes longer than to read it


class _FlawError(Exception):
    """One thing that is wrong with the file, as a clause."""


def sound_arrays(path: Path, file: h5py.File, size_bytes: int) -> dict[str, Arrays]:
    """Arrays by group, once attributes, links, storage, kinds and shapes are checked.

    Raises TableError, which names the array. `size_bytes` is the size of the file, which no array may exceed. Nothing
    that lies outside the file is opened.
    """
    found: dict[str, Arrays] = {}
    try:
        _check_attributes(file)
        for name, group in _members(file, h5py.Group):
            sizes = dict(FIXED_SIZES)
            arrays = found[name] = {}
            for array_name, array in _members(group, h5py.Dataset):
                where, declared = f"{name}/{array_name}", SCHEMA.get(name, {}).get(array_name)
                if not _is_dimension_only(array):
                    _check_storage(where, array, size_bytes)
                    _check_kind(where, array, declared, sizes)
                    arrays[array_name] = array
                elif declared is not None and declared.dimensions != (array_name,):
                    raise _FlawError(f"{where}: is marked as a dimension without values")
                else:
                    _check_storage(where, array, math.inf)
    except _FlawError as flaw:
        raise TableError(f"{path}: is corrupted: {flaw}; build it again") from None
    return found


def check_values(path: Path, groups: Mapping[str, Arrays], device: Device, *, with_sweeps: bool) -> None:
    """Check the values of every array, and that names are those of the device; raises TableError as `sound_arrays`.

    The sweeps are most of a file and only pictures read them, so they are looked at only `with_sweeps`.
    """
    names = {"actuator": [each.name for each in device.actuators], "zone": [each.name for each in device.zones]}
    try:
        for group_name, arrays in groups.items():
            for name, declared in SCHEMA.get(group_name, {}).items():
                is_skipped = not with_sweeps and group_name.endswith("sweep")
                if is_skipped or name not in arrays:
                    continue
                array = arrays[name]
                if declared.kind is not Kind.TEXT:
                    _check_numbers(f"{group_name}/{name}", array, declared)
                elif name in _NAMES and array.asstr()[...].tolist() != names[name]:
                    raise _FlawError(f"{group_name}/{name}: does not name the {name}s of its device")
            if group_name in _ROWS:
                _check_rows(group_name, arrays, device)
            if group_name == "modes":
                _check_modes(arrays, device)
    except _FlawError as flaw:
        raise TableError(f"{path}: is corrupted: {flaw}; build it again") from None


def _members(group: h5py.Group, kind: type) -> Iterator[tuple[str, Any]]:
    """Members of a group by name; a link that leaves the file, and a member of another kind, are flaws."""
    for name in group:
        where = f"{group.name}/{name}".lstrip("/")
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise _FlawError(f"{where}: is a link to somewhere else, which a table never has")
        member = group[name]
        if not isinstance(member, kind):
            raise _FlawError(f"{where}: expected a {kind.__name__.lower()}")
        yield name, member


def _is_dimension_only(array: h5py.Dataset) -> bool:
    """Whether the array only gives a dimension its length; its values mean nothing."""
    return bytes(array.attrs.get("NAME", b"")).startswith(_DIMENSION_ONLY)


def _check_attributes(file: h5py.File) -> None:
    for name in TEXT_ATTRIBUTES:
        if name in file.attrs and not isinstance(file.attrs[name], str):
            raise _FlawError(f"attribute {name}: expected text")
    for name in WHOLE_ATTRIBUTES:
        if name in file.attrs and not _is_whole(file.attrs[name]):
            raise _FlawError(f"attribute {name}: expected a whole number")
    for name in REAL_ATTRIBUTES:
        if name in file.attrs and not _is_length(file.attrs[name]):
            raise _FlawError(f"attribute {name}: expected a length above 0")


def _is_whole(value: object) -> bool:
    """NetCDF stores one number as an array of one element."""
    return isinstance(value, np.ndarray) and value.shape == (1,) and value.dtype.kind in "iu"


def _is_length(value: object) -> bool:
    is_real = isinstance(value, np.ndarray) and value.shape == (1,) and value.dtype.kind == "f"
    return is_real and bool(0 < value[0] < np.inf)  # type: ignore[index]  # an array


def _check_storage(where: str, array: h5py.Dataset, most_bytes: float) -> None:
    storage = array.id.get_create_plist()
    if array.is_virtual or storage.get_external_count():
        raise _FlawError(f"{where}: its values are in another file, which a table never has")
    if storage.get_layout() == h5py.h5d.CHUNKED or storage.get_nfilters():
        raise _FlawError(f"{where}: is compressed or in chunks, which a table never is")
    if array.shape is None or array.nbytes > most_bytes:
        raise _FlawError(f"{where}: has shape {array.shape}, more than the file can hold")


def _check_kind(where: str, array: h5py.Dataset, declared: ArrayKind | None, sizes: dict[str, int]) -> None:
    """Compare with the declaration; the first array with a dimension decides the length of that dimension."""
    is_text = h5py.check_string_dtype(array.dtype) is not None and array.dtype.kind == "O"
    if not is_text and array.dtype.kind not in "fiu":
        raise _FlawError(f"{where}: is of {array.dtype}; expected numbers or text")
    labels = (array.attrs.get("units"), array.attrs.get("long_name"))
    if not all(isinstance(label, str) for label in labels) or not _is_whole(array.attrs.get("crc32")):
        raise _FlawError(f"{where}: expected texts as its units and long_name, and a whole number as its crc32")
    if declared is None:
        return
    if is_text != (declared.kind is Kind.TEXT) or array.dtype.kind not in declared.kind:
        raise _FlawError(f"{where}: is of {array.dtype}; expected {declared.kind.name.lower()} values")
    dimensions = declared.dimensions
    if len(array.shape) != len(dimensions) or any(
        size != sizes.setdefault(name, size) for name, size in zip(dimensions, array.shape, strict=True)
    ):
        expected = ", ".join(f"{name} {sizes.get(name, 'any')}" for name in dimensions)
        raise _FlawError(f"{where}: has shape {array.shape}; expected ({expected})")


def _check_numbers(where: str, array: h5py.Dataset, declared: ArrayKind) -> None:
    for piece in pieces(array):
        if piece.dtype.kind == "f":
            wrong = np.isinf(piece) if not declared.may_be_infinite else np.zeros_like(piece, dtype=bool)
            if not declared.may_be_nan:
                wrong |= np.isnan(piece)
            if wrong.any():
                raise _FlawError(f"{where}: holds {piece[wrong][0]}; expected finite values")
        for bound, is_beyond in ((declared.least, np.less), (declared.greatest, np.greater)):
            if bound is not None and is_beyond(piece, bound).any():
                raise _FlawError(f"{where}: holds a value {'below' if is_beyond is np.less else 'above'} {bound:g}")


def _check_rows(where: str, arrays: Arrays, device: Device) -> None:
    """Lengths and orders that readers of best rows and clicks rely on; they refuse what is missing."""
    if "level" in arrays:
        levels_db = arrays["level"][...]
        if not len(levels_db) or (levels_db[1:] <= levels_db[:-1]).any():
            raise _FlawError(f"{where}/level: expected rising levels")
    if where == "clicks":
        _check_basis(arrays, device)
        _check_placements(arrays, device)


def _check_basis(arrays: Arrays, device: Device) -> None:
    sample_s = arrays["sample"][...]
    if len(sample_s) < 2 or not 0 < sample_s[1] - sample_s[0] <= 1:
        raise _FlawError("clicks/sample: expected at least two rising times")
    if arrays["set_samples"][...].max(initial=0) > len(sample_s):
        raise _FlawError("clicks/set_samples: is more than the functions of the basis have")
    if arrays["function_actuator"][...].max(initial=0) >= len(device.actuators):
        raise _FlawError("clicks/function_actuator: is the index of an actuator that the device does not have")


def _check_placements(arrays: Arrays, device: Device) -> None:
    """The fingers of a click lie at rising places."""
    finger = arrays["finger_place"][...]
    try:
        places = Places.at(device.surface.corner_m, read_points(arrays, "place").tolist())
    except ValueError as error:
        raise _FlawError(f"clicks/place: {error}") from None
    if not finger.shape[1] or finger[:, 0].min(initial=0) < 0 or finger.max(initial=0) >= places.count:
        raise _FlawError("clicks/finger_place: expected at least one finger, at one of the places")
    before, after = finger[:, :-1], finger[:, 1:]
    if not ((after == -1) | ((before >= 0) & (after > before))).all():
        raise _FlawError("clicks/finger_place: expected rising places, and -1 only behind the last finger")
    for name in ("felt_level", "quiet_level"):
        if arrays[name].shape[1] != _SPREADS:
            raise _FlawError(f"clicks/{name}: expected {_SPREADS} figures of each click")


def _check_modes(arrays: Arrays, device: Device) -> None:
    """Kernels without bounds checks read them."""
    frequency_hz, own_hz, corner_m = arrays["frequency"][...], arrays["natural_frequency"][...], device.surface.corner_m
    _check_even("modes/along", arrays["along"][...], corner_m.real, _FEWEST_PLACES)
    _check_even("modes/across", arrays["across"][...], corner_m.imag, _FEWEST_PLACES if corner_m.imag else 1)
    if not len(frequency_hz) or (frequency_hz[1:] <= frequency_hz[:-1]).any() or arrays["threshold"][...].min() <= 0:
        raise _FlawError("modes/frequency: expected rising frequencies with thresholds above 0")
    if not arrays["drive"][...].any():
        raise _FlawError("modes/drive: no actuator moves any function")
    if len(arrays["damper"]) != len(device.actuators):
        raise _FlawError(f"modes/damper: expected {len(device.actuators)}, one for each actuator of the device")
    if not 0 < len(own_hz) <= arrays["shape"].shape[2]:
        raise _FlawError("modes/natural_frequency: expected one at least, and no more than there are functions")
    if np.isin(own_hz[arrays["damping"][...] == 0], frequency_hz).any():
        raise _FlawError("modes/natural_frequency: is one of the frequencies, undamped, where it moves without end")


def _check_even(where: str, at_m: Array, side_m: float, fewest: int) -> None:
    even_m = np.linspace(0, side_m, len(at_m))
    if len(at_m) < fewest or (not side_m and len(at_m) > 1) or not np.allclose(at_m, even_m, rtol=0, atol=_ROUNDING_M):
        raise _FlawError(f"{where}: expected an even grid from one end of the surface to the other")
