"""Arrays and labels of a NetCDF or MAT file that somebody else wrote, read in a child process with bounded time.

HDF5 is a C library that follows the addresses in a file. A few changed bits lead it into a cycle that never ends, or to
memory that is not its own; Python can neither interrupt the one nor survive the other. HDF5 would also follow a file's
links and external storage to any file of this machine, or to a pipe that never ends, and a small file may declare
arrays that fill the memory. So links, outside storage and large arrays are refused before xarray opens the file, and
all of this happens in a child process: it may take LIMIT_S of processor time, and however it ends, this process only
gets a refusal. Arrays come back as .npy data in anonymous memory, which can hold no code.
SciPy, which reads MAT files, reads beyond its memory on some damaged ones too.
"""

import os
import resource
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from base.child import Child, ChildError, Parent
from precompute.measurements.columns import SIMULATED
from precompute.measurements.types import MeasurementError

LIMIT_S = 20
"""Processor time of the child, with its start: some hundred times what a file of a thousand readings takes."""
_LONGEST_S = 300.0
"""The longest that reading may take by the clock, even on a machine that much other work keeps busy."""
_MOST_BYTES = 1 << 26
"""The most bytes of all arrays together: eight million numbers."""


class Variable(NamedTuple):
    """An array with the names of its dimensions. `units` is the text that the file states, or None without it."""

    name: str
    dimensions: tuple[str, ...]
    units: str | None
    values: NDArray[Any]


class Content(NamedTuple):
    """Content of a file of measurements."""

    variables: Sequence[Variable]
    actuators: tuple[str, ...] | None
    """The coordinate of the dimension `actuator`, or None in a file that has no such coordinate."""
    is_simulated: bool


def read_content(path: Path, limit_s: int = LIMIT_S) -> Content:
    """Read a file in a child process that may take `limit_s` of processor time. Raises MeasurementError."""
    if not path.is_file():
        raise MeasurementError(f"{path}: is not a plain file; name a file of measurements")
    memory = os.memfd_create("measurements")
    with os.fdopen(memory, "r+b") as arrays:
        arguments = {"path": str(path), "arrays": memory, "limit_s": limit_s}
        with Child(__name__, arguments, name="its reader", descriptors=[memory]) as child:
            try:
                said = child.read(_LONGEST_S)
            except ChildError as error:
                raise MeasurementError(
                    f"{path}: is damaged: {error}, in the library that reads it; export it again"
                ) from None
            finally:
                child.kill()  # it has nothing to finish, and may never end
        if "refused" in said:
            raise MeasurementError(said["refused"])
        variables = [
            Variable(name, tuple(dimensions), units, np.load(arrays, allow_pickle=False))
            for name, dimensions, units in said["variables"]
        ]
        actuators = said["actuators"]
        return Content(variables, None if actuators is None else tuple(actuators), said["is_simulated"])


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The child: says what the file holds or why it is refused, and writes the arrays into the memory it was given."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (arguments["limit_s"],) * 2)
    try:
        content = load_content(Path(arguments["path"]))
    except MeasurementError as error:
        parent.say({"refused": str(error)})
        return
    with os.fdopen(arguments["arrays"], "r+b") as arrays:
        for variable in content.variables:
            np.save(arrays, variable.values, allow_pickle=False)
        arrays.flush()
        arrays.seek(0)  # the parent reads at the same place
    variables = [each[:-1] for each in content.variables]
    parent.say({"variables": variables, "actuators": content.actuators, "is_simulated": content.is_simulated})


def load_content(path: Path) -> Content:
    """Read a file in this process; raises MeasurementError. What the libraries make of a damaged file is unknown."""
    if path.suffix.lower() == ".mat":
        from precompute.measurements.mat import load_arrays

        return load_arrays(path)
    import xarray

    try:
        _check_storage(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error", xarray.SerializationWarning)  # such as of several fill values
            dataset = xarray.load_dataset(path, engine="h5netcdf", phony_dims="sort")
        variables = [
            Variable(str(name), tuple(map(str, values.dims)), _text(values.attrs.get("units")), _plain(values.values))
            for name, values in dataset.data_vars.items()
        ]
        actuators = tuple(map(str, dataset.actuator.values)) if "actuator" in dataset.coords else None
        return Content(variables, actuators, any(SIMULATED in str(value) for value in dataset.attrs.values()))
    except MeasurementError:
        raise
    except Exception as error:  # of a damaged file h5py and xarray raise almost every kind
        raise MeasurementError(f"{path}: not a NetCDF-4 file: {error}") from error


def _text(label: object) -> str | None:
    return label if isinstance(label, str) else None


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Python's objects as their text, since an array of objects is stored as code."""
    return values.astype(str) if values.dtype.hasobject else values


def _check_storage(path: Path) -> None:
    """Raise MeasurementError for an array that lies outside the file, and for arrays that are too large."""
    import h5py

    size_bytes = 0
    with h5py.File(path) as file:
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                raise MeasurementError(f"{path}: {name}: is a link, which is not followed; write the values themselves")
            array = file[name]
            if not isinstance(array, h5py.Dataset):
                continue
            if array.is_virtual or array.id.get_create_plist().get_external_count():
                raise MeasurementError(f"{path}: {name}: its values are in another file; write them into this one")
            if array.shape is not None:
                size_bytes += array.nbytes
            if size_bytes > _MOST_BYTES:
                raise MeasurementError(
                    f"{path}: {name}: has shape {array.shape}; with it all arrays are {size_bytes / 1e6:.3g} MB, "
                    f"expected at most {_MOST_BYTES / 1e6:.0f} MB: fewer measurements suffice"
                )
