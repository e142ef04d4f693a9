"""MAT files of version 5 (MATLAB, Octave, SciPy), read as wide tables (tables/MEASUREMENTS.md).

A name has `_` for spaces and its unit as the last words: `frequency_Hz`, `left_35mm_real_m_s2`. A matrix has a column
for each place in the variable `position_mm`.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from base.points import parts_of
from engine.device import Device
from precompute.measurements.columns import column_names
from precompute.measurements.csv import measurements_of
from precompute.measurements.mat_content import Content, read_content
from precompute.measurements.sheet import Sheet, split_title
from precompute.measurements.types import MeasurementError, Measurements
from precompute.measurements.wide import FREQUENCY, PLACE

_UNIT = re.compile(r"_((?:[mcku]?m|k?g|k?Hz|deg|rad|percent)(?:(?:_per)?_(?:s2|s|N))*)$")


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
