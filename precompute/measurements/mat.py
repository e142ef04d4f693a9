"""MAT files of version 5 (MATLAB, Octave, SciPy), read as wide tables (tables/MEASUREMENTS.md).

A name has `_` for spaces and its unit as the last words: `frequency_Hz`, `left_35mm_real_m_s2`. A matrix has a column
for each place in the variable `position_mm`.

On some damaged files SciPy reads beyond its memory, which Python cannot survive. So a child process reads the file: it
may take LIMIT_S of processor time, and however it ends, this process only gets a refusal. Arrays come back as .npy data
in anonymous memory, which can hold no code.
"""

import math
import os
import re
import resource
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from base.child import Child, ChildError, Parent
from base.points import parts_of
from engine.device import Device
from precompute.measurements.columns import SIMULATED, column_names
from precompute.measurements.csv import FREQUENCY, PLACE, measurements_of
from precompute.measurements.sheet import MOST_ROWS, Sheet, split_title
from precompute.measurements.types import MeasurementError, Measurements

_UNIT = re.compile(r"_((?:[mcku]?m|k?g|k?Hz|deg|rad|percent)(?:(?:_per)?_(?:s2|s|N))*)$")
LIMIT_S = 20  # processor time of the child, with its start: some hundred times what a file of a thousand readings takes
_LONGEST_S = 300.0  # the longest that reading may take by the clock, even on a machine that much other work keeps busy
_NUMBERS = "double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_MOST_NUMBERS = 10 * MOST_ROWS


class Content(NamedTuple):
    """The numeric arrays of a file by name, and whether any text of it says SIMULATED."""

    arrays: Mapping[str, NDArray[Any]]
    is_simulated: bool


def read_mat(path: Path, device: Device, sensor_mass_kg: float) -> Measurements:
    """Responses of numeric arrays (frequency,) or (frequency, place); NaN is no reading. Raises MeasurementError."""
    return arrays_to_measurements(read_content(path), path, device, sensor_mass_kg)


def arrays_to_measurements(content: Content, path: Path, device: Device, sensor_mass_kg: float) -> Measurements:
    """The measurements in the arrays of a file. Raises MeasurementError."""
    arrays = content.arrays
    titles = {name: _title(name) for name in arrays}
    axes = [name for name, title in titles.items() if FREQUENCY.fullmatch(split_title(title)[0])]
    position = next((name for name, title in titles.items() if split_title(title)[0] == "position"), None)
    if len(axes) != 1 or len(arrays) < 2:
        expected = "expected frequency_Hz, position_mm and a complex NAME_acceleration_m_s2 for each actuator NAME"
        raise MeasurementError(f"{path}: has the variables {', '.join(arrays) or 'none'}; {expected}")
    lines = arrays[axes[0]].size
    axes_of_places = len(parts_of(device.surface.corner_m))
    if position is not None and arrays[position].shape[-1] != 2 == axes_of_places:
        raise MeasurementError(f"{path}: {position}: expected a row of two numbers for each place, along and across")
    places = np.zeros((0, 1)) if position is None else arrays[position].reshape(-1, axes_of_places)
    columns: list[tuple[str, NDArray[Any]]] = []
    for name, array in arrays.items():
        words, unit = split_title(titles[name])
        bracket = "" if unit is None else f" ({unit})"
        if name == position:
            continue
        is_one = name == axes[0] or words in column_names(device) or PLACE.search(words) is not None
        if array.size in (1, lines) and is_one:
            columns.append((words + bracket, np.resize(array, lines)))
        elif array.shape in ((lines, len(places)), (len(places), lines)):
            matrix, at = array if len(array) == lines else array.T, split_title(titles[str(position)])[1] or "mm"
            shown = [" x ".join(f"{part:.9f}" for part in place) for place in places.tolist()]
            columns += [(f"{words} {place} {at}{bracket}", matrix[:, i]) for i, place in enumerate(shown)]
        else:
            expected = f"expected {lines} values and the place in the name, or a column for each place in position_mm"
            raise MeasurementError(f"{path}: {name}: has the shape {array.shape}; {expected}")
    cells = [["" if value != value else repr(value) for value in values.tolist()] for _, values in columns]
    sheet = Sheet(
        [title for title, _ in columns],
        [list(row) for row in zip(*cells, strict=True)],
        [f"value {line}" for line in range(1, lines + 1)],
        content.is_simulated,
    )
    return measurements_of(sheet, device, sensor_mass_kg, str(path))


def _title(name: str) -> str:
    """Heading of a wide table: the name with its last words as the unit in brackets."""
    match = _UNIT.search(name)
    words = re.sub(r"(\d)p(\d)", r"\1.\2", name[: match.start()] if match else name).replace("_", " ")
    return f"{words} ({match[1].replace('_per', '').replace('_', '/').replace('percent', '%')})" if match else words


def read_content(path: Path, limit_s: int = LIMIT_S) -> Content:
    """Read a file in a child process that may take `limit_s` of processor time. Raises MeasurementError."""
    memory = os.memfd_create("measurements")
    with os.fdopen(memory, "r+b") as arrays:
        arguments = {"path": str(path), "arrays": memory, "limit_s": limit_s}
        with Child(__name__, arguments, name="its reader", descriptors=[memory]) as child:
            try:
                said = child.read(_LONGEST_S)
            except ChildError as error:
                raise MeasurementError(f"{path}: is damaged: {error}; export it again") from None
            finally:
                child.kill()  # it has nothing to finish, and may never end
        if "refused" in said:
            raise MeasurementError(said["refused"])
        return Content({name: np.load(arrays, allow_pickle=False) for name in said["names"]}, said["is_simulated"])


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
        for values in content.arrays.values():
            np.save(arrays, values, allow_pickle=False)
        arrays.flush()
        arrays.seek(0)  # the parent reads at the same place
    parent.say({"names": list(content.arrays), "is_simulated": content.is_simulated})


def load_content(path: Path) -> Content:
    """Read a file in this process; raises MeasurementError. What SciPy makes of a damaged file is unknown."""
    import scipy.io

    with path.open("rb") as file:
        if file.read(10) == b"MATLAB 7.3":
            raise MeasurementError(f"{path}: is a MAT file of version 7.3, HDF5; save it with save(..., '-v7')")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as for a duplicate name
            kinds = scipy.io.whosmat(str(path), appendmat=False)
            wrong = [f"{name} is a {kind}" for name, _, kind in kinds if kind not in (*_NUMBERS, "char")]
            if not wrong and sum(math.prod(shape) for _, shape, _ in kinds) <= _MOST_NUMBERS:
                content = scipy.io.loadmat(str(path), appendmat=False)
            else:
                what = wrong[0] if wrong else f"has more than {_MOST_NUMBERS} numbers"
                raise MeasurementError(f"{path}: {what}; save the responses alone, as arrays")
    except MeasurementError:
        raise
    except Exception as error:  # scipy raises many of Python's on malformed files
        remedy = "save it with save(..., '-v7')"
        raise MeasurementError(f"{path}: cannot be read as a MAT file of version 5 ({error}); {remedy}") from error
    texts = [str(content[name]) for name, _, kind in kinds if kind == "char"]
    arrays = {name: np.atleast_2d(content[name]) for name, _, kind in kinds if kind != "char"}
    return Content(arrays, any(SIMULATED in text for text in texts))
