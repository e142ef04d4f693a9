"""Files of natural frequencies and damping ratios to modes: CSV, or dataset 55 of a universal file.

Modal programs write such files, and `pick_modes` makes one from responses (tables/MEASUREMENTS.md).
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from base.arrays import Array, Complex, Points
from base.points import point_text
from engine.device import Device
from engine.device.quantity import QuantityError, read_point_on
from precompute.measurements.columns import SIMULATED, join_places, place_columns
from precompute.measurements.measurement_file import check_file, read_table_text
from precompute.measurements.sheet import read_columns, read_sheet
from precompute.measurements.types import MOST_KG, MeasurementError, is_outside

FREQUENCY_ERROR, DAMPING_ERROR = 0.002, 0.1
"""Relative standard deviations where a file states none. ESTIMATE: what repeated modal tests of small bars scatter."""
_LEAST_FREQUENCY_ERROR, _LEAST_DAMPING_ERROR = 1e-4, 5e-3  # a program's fit may scatter by 0; no bar is known better
_KNOWN = {
    "mode": "",
    "frequency": "Hz",
    "damping ratio": "",
    "loss factor": "",
    "Q": "",
    "frequency error": "Hz",
    "damping ratio error": "",
    "sensor mass": "kg",
    "sensor position": "m",
}
_OTHER_NAMES = {
    "natural frequency": "frequency",
    "damping": "damping ratio",
    "q": "Q",
    "damping error": "damping ratio error",
}
_FILLED = ("frequency", "sensor mass", "sensor position")
_SHAPE = re.compile(r"shape at ([^(]+?) ?(?:\(1\))?")
_EXAMPLE = "frequency (Hz),damping ratio (%)"
_SHAPES, _NORMAL, _COMPLEX = 55, 2, (3, 7)  # a dataset of universal files, and its types of analysis


@dataclass(frozen=True)
class Modes:
    """Measured modes of the untouched surface, on its mounts and with its actuators, in rising order.

    frequency_hz, damping_ratio (mode,): |p| / 2 pi and -Re p / |p| of the pole p; a damping that is not known is NaN.
    frequency_error, damping_error (mode,): relative standard deviations. place_m (place,) and shape (mode, place):
    deflections, each mode with a scale of its own, NaN where not known. A sensor of sensor_mass_kg lay at sensor_m.
    """

    frequency_hz: Array
    damping_ratio: Array
    frequency_error: Array
    damping_error: Array
    place_m: Points
    shape: Complex
    sensor_mass_kg: float
    sensor_m: complex
    is_simulated: bool

    def __len__(self) -> int:
        """Number of modes."""
        return len(self.frequency_hz)


def read_modes(path: Path, device: Device, sensor_mass_kg: float = 0.0) -> Modes:
    """Read modes; `sensor_mass_kg` applies where the file states none. Raises MeasurementError, OSError."""
    check_file(path)
    if path.suffix.lower() == ".csv":
        return parse_modes(read_table_text(path), device, sensor_mass_kg, str(path))
    return _read_universal(path, device, sensor_mass_kg)


def parse_modes(text: str, device: Device, sensor_mass_kg: float, source: str) -> Modes:
    """Read CSV text with one mode a row. Raises MeasurementError, which names the row and the column."""
    sheet = read_sheet(text, source, _EXAMPLE)
    titles = [_usual_title(title) for title in sheet.titles]
    places = {match[0].removesuffix("(1)").strip(): match[1] for title in titles if (match := _SHAPE.fullmatch(title))}
    known = {each: unit for name, unit in _KNOWN.items() for each in place_columns(device, name)}
    known |= dict.fromkeys(places, "")
    filled = {each for name in _FILLED for each in place_columns(device, name)}
    columns = read_columns(sheet._replace(titles=titles), known, lambda name: name not in filled, device, source)
    if "frequency" not in columns or not sheet.rows:
        raise MeasurementError(f"{source}: has no natural frequency; write rows below the header {_EXAMPLE}")
    hz, empty = columns["frequency"], np.full(len(sheet.rows), np.nan)
    given = [name for name in ("damping ratio", "loss factor", "Q") if name in columns]
    if len(given) > 1:
        raise MeasurementError(f"{source}: has the columns {' and '.join(given)}; they say the same, keep one")
    damping = columns.get("damping ratio", columns.get("loss factor", empty) / 2)
    if given == ["Q"]:
        damping = 1 / (2 * np.maximum(columns["Q"], 1e-9))  # what is not above 0 is refused as a damping
    mass_kg = columns.get("sensor mass", np.array([sensor_mass_kg]))
    own_m = join_places(columns, device, "sensor position", source)
    sensor_m = empty if own_m is None else own_m
    for name, column in (("sensor mass", mass_kg), ("sensor position", sensor_m)):
        if not np.isnan(column[0]) and (column != column[0]).any():
            raise MeasurementError(f"{source}: {name}: differs between rows; modes are of one surface with one sensor")
    shape = np.array([columns[name] for name in places]).reshape(len(places), len(hz)).T
    with np.errstate(divide="ignore", invalid="ignore"):  # a frequency of 0 is refused below
        errors = (columns.get("frequency error", empty) / hz, columns.get("damping ratio error", empty) / damping)
    place_m = np.array([_place_m(text, device, source) for text in places.values()])
    found = Modes(hz, damping, *errors, place_m, shape + 0j, float(mass_kg[0]), sensor_m[0].item(), sheet.is_simulated)
    return _checked(found, device, source, sheet.labels)


def _usual_title(title: str) -> str:
    """A title as in this project: other programs write other names, capitals and square brackets."""
    name, bracket, unit = title.strip().strip('"').replace("[", "(").replace("]", ")").partition("(")
    name = name.strip().lower()
    name = _OTHER_NAMES.get(name, name)
    has_unit = bracket or not (name in ("mode", "Q") or _SHAPE.fullmatch(name))
    return f"{name} {bracket}{unit}".strip() if has_unit else f"{name} (1)"


def _place_m(text: str, device: Device, source: str) -> complex:
    try:
        return read_point_on(text, device.surface.corner_m, beside_too=True)
    except QuantityError as error:
        raise MeasurementError(f"{source}: column 'shape at {text}': {error}") from None


def _checked(modes: Modes, device: Device, source: str, places: list[str]) -> Modes:
    """The modes with the usual errors where none are stated. Raises MeasurementError where a value is impossible."""
    corner_m, kind = device.surface.corner_m, device.surface.kind
    hz, damping = modes.frequency_hz, modes.damping_ratio
    rules = (
        ("frequency", hz, "Hz", ~((hz > 0) & np.isfinite(hz)), "expected more than 0 Hz"),
        ("frequency", hz, "Hz", np.diff(hz, prepend=0.0) <= 0, "expected rising frequencies; leave repeated ones out"),
        ("damping ratio", 100 * damping, "%", (damping <= 0) | (damping >= 1), "expected more than 0 and below 100 %"),
        ("frequency error", modes.frequency_error * hz, "Hz", modes.frequency_error < 0, "expected 0 or more"),
        (
            "damping ratio error",
            100 * modes.damping_error * damping,
            "%",
            modes.damping_error < 0,
            "expected 0 or more",
        ),
    )
    for name, value, unit, is_bad, expected in rules:
        if is_bad.any():
            row = int(np.argmax(is_bad))
            raise MeasurementError(f"{source}: {places[row]}: {name}: {value[row]:g} {unit}: {expected}")
    for name, place_m in (("sensor position", np.array([modes.sensor_m])), ("shape at", modes.place_m)):
        for at_m in place_m[is_outside(place_m, corner_m)]:
            text = f"expected 0 to {point_text(corner_m)}, the {kind}'s {'length' if kind == 'bar' else 'sides'}"
            raise MeasurementError(f"{source}: {name}: {point_text(at_m)}: {text}")
    if not 0 <= modes.sensor_mass_kg <= MOST_KG:
        raise MeasurementError(f"{source}: sensor mass: {1e3 * modes.sensor_mass_kg:g} g: expected 0 to 1000 g")
    if modes.sensor_mass_kg and np.isnan(modes.sensor_m):
        raise MeasurementError(f"{source}: has a sensor mass without its place; give a column sensor position (mm)")
    # The scatter of a pole is the same in every direction: as a share of its size that of the damping ratio.
    usual = np.hypot(FREQUENCY_ERROR, DAMPING_ERROR * np.nan_to_num(damping))
    frequency_error = np.where(np.isnan(modes.frequency_error), usual, modes.frequency_error)
    damping_error = np.where(np.isnan(modes.damping_error), DAMPING_ERROR, modes.damping_error)
    return replace(
        modes,
        frequency_error=np.maximum(frequency_error, _LEAST_FREQUENCY_ERROR),
        damping_error=np.maximum(damping_error, _LEAST_DAMPING_ERROR),
    )


def _read_universal(path: Path, device: Device, sensor_mass_kg: float) -> Modes:
    """Modes of dataset 55: frequency and damping ratio of normal modes, eigenvalues in rad/s of complex ones.

    Shapes are the deflections in the direction of bending, z, at nodes whose x, and y on a plate, are their place.
    """
    from precompute.measurements.uff import read_sets

    sets, place_m, _ = read_sets(path, device)
    found = [(f"dataset {n} (55)", part) for n, part in enumerate(sets, 1) if part["type"] == _SHAPES]
    rows = []
    for where, part in found:
        kind = int(part["analysis_type"])
        if kind not in (_NORMAL, *_COMPLEX):
            raise MeasurementError(f"{path}: {where}: analysis_type: {kind}: expected modes, which are 2, 3 or 7")
        if kind == _NORMAL:
            # Hysteretic damping is a loss factor, twice the damping ratio of the same width.
            damping = float(part["modal_damp_vis"]) or float(part["modal_damp_his"]) / 2
            rows.append((float(part["freq"]), damping or np.nan, where, part))
        elif (pole := complex(part["eig"])).imag >= 0:  # one of each conjugate pair
            rows.append((abs(pole) / (2 * np.pi), -pole.real / (abs(pole) or 1.0) or np.nan, where, part))
    if not rows:
        raise MeasurementError(f"{path}: has no dataset 55 of a mode; export modes, or write a CSV file: {_EXAMPLE}")
    rows.sort(key=lambda row: row[0])
    nodes = sorted({int(n) for *_, part in rows for n in np.atleast_1d(part["node_nums"])} & place_m.keys())
    shape = np.full((len(rows), len(nodes)), np.nan, dtype=np.complex128)
    for row, (_, _, where, part) in zip(shape, rows, strict=True):
        if len(np.atleast_1d(part["node_nums"])) != len(np.atleast_1d(part["r3"])):
            raise MeasurementError(f"{path}: {where}: expected a value in x, y and z at each node; export it again")
        across = dict(
            zip(np.atleast_1d(part["node_nums"]).astype(int).tolist(), np.atleast_1d(part["r3"]), strict=True)
        )
        if any(across.values()):
            row[:] = [across.get(node, np.nan) for node in nodes]
    hz, damping = np.array([row[:2] for row in rows]).T
    is_simulated = any(SIMULATED in str(part.get("id1")) for *_, part in rows)
    empty, at_m = np.full(len(rows), np.nan), np.array([place_m[node] for node in nodes])
    modes = Modes(hz, damping, empty, empty, at_m, shape, sensor_mass_kg, np.nan, is_simulated)
    return _checked(modes, device, str(path), [where for _, _, where, _ in rows])
