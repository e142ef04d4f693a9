"""Universal files: frequency responses (dataset 58) at nodes (dataset 15 or 2411), read and written with pyuff."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyuff

from base.points import point_text
from engine.device import Device
from engine.device.quantity import QuantityError
from precompute.measurements.columns import SIMULATED, ResponseUnit, read_response_unit, to_acceleration, unit_scale
from precompute.measurements.types import (
    AT_ACTUATOR,
    Kind,
    MeasurementError,
    Measurements,
    check_measurements,
    nearest_actuator,
    text_of_places,
)

# Numbers of datasets and of their fields, of the universal file format (SDRC; pyuff names them)
_NODES = (15, 2411)
_RESPONSES, _UNITS = 58, 164  # datasets
_FREQUENCY_RESPONSE = 4
_FREQUENCY, _ACCELERATION, _FORCE, _UNTOLD = 18, 12, 13, (0, 1)  # specific data types of an axis
_ORDERS = {_ACCELERATION: 0, 11: 1, 8: 2}
"""By the type of the ordinate, how many derivatives lead to the acceleration: from a velocity 1, a displacement 2."""
_SI_UNITS = 1
_COMPLEX = (5, 6)  # ordinate data types, of single and double precision
_DENOMINATORS = {8: "displacement", 11: "velocity", 12: "acceleration"}
_ACROSS, _UNSAID = 3, 0  # directions of a response: +z or -z, and a file that says none
_LONGEST_LINE = 80  # of an ID line of dataset 58


def read_uff(path: Path, device: Device, sensor_mass_kg: float) -> Measurements:
    """Read a row from every line of every response: the acceleration for one actuator at full scale, or for 1 N.

    The x of a node is its place along the surface, its y that across a plate. The reference node is the place of the
    force, or lies at an actuator. What a file declares is read, or refused by its name. Raises MeasurementError.
    """
    sets, place_m, units = read_sets(path, device)
    responses = [(number, part) for number, part in enumerate(sets, 1) if part["type"] == _RESPONSES]
    if not responses:
        modes = "; give --modes to fit its modes" if any(part["type"] == 55 for part in sets) else ""
        raise MeasurementError(f"{path}: has no dataset 58; expected frequency responses{modes}")
    rows = [_read_response(part, place_m, units, device, f"{path}: dataset {n} (58)") for n, part in responses]
    if len(kinds := {row.is_per_newton: number for (number, _), row in zip(responses, rows, strict=True)}) > 1:
        text = f"dataset {kinds[True]} (58) is per newton, dataset {kinds[False]} of full scale; make two files"
        raise MeasurementError(f"{path}: {text}")
    counts = [len(row.frequency_hz) for row in rows]
    numbers = np.repeat([number for number, _ in responses], counts)
    position_m, reference_m = (np.repeat(x, counts) for x in zip(*(row[:2] for row in rows), strict=True))
    driven = nearest_actuator(device, reference_m)[:, None] == np.arange(len(device.actuators))
    frequency_hz = np.concatenate([row.frequency_hz for row in rows])
    return check_measurements(
        Measurements(
            kind=Kind.RESPONSE,
            position_m=position_m,
            frequency_hz=np.where(driven, frequency_hz[:, None], np.nan),
            amplitude=driven.astype(np.complex128),
            sensor_mass_kg=np.full(len(position_m), sensor_mass_kg),
            finger_m=np.full(len(position_m), np.nan),
            acceleration=np.concatenate([row.acceleration for row in rows]),
            is_simulated=any(SIMULATED in str(part.get("id1")) for _, part in responses),
            force_m=reference_m if rows[0].is_per_newton else None,
        ),
        device,
        str(path),
        lambda row: f"dataset {numbers[row]} (58) at {frequency_hz[row]:g} Hz",
    )


def read_sets(path: Path, device: Device) -> tuple[Sequence[Mapping[str, Any]], dict[int, Any], tuple[float, float]]:
    """Datasets of a universal file, each node's place in m, its units of length and force. Raises MeasurementError."""
    try:
        found = pyuff.UFF(str(path)).read_sets()
        sets: list[Mapping[str, Any]] = [found] if isinstance(found, dict) else list(found)  # a single one comes bare
    except Exception as error:  # pyuff raises bare exceptions, and many of Python's, on malformed files
        cause: BaseException = error
        while cause.__context__ is not None:  # pyuff says "Error when reading data-set(s)." in place of the cause
            cause = cause.__context__
        raise MeasurementError(f"{path}: cannot be read as a universal file: {cause}") from error
    units = next((part for part in sets if part["type"] == _UNITS), None)
    unit_m, unit_n = (1.0 if units is None else _unit_of(units, key, path) for key in ("length", "force"))
    nodes = _read_nodes(sets, path, is_plate=isinstance(device.surface.corner_m, complex))
    return sets, {number: unit_m * place for number, place in nodes.items()}, (unit_m, unit_n)


def write_uff(path: Path, measurements: Measurements, device: Device, comment: str) -> None:
    """Write responses as `read_uff` reads them: for each actuator at full scale, one dataset 58 for each place.

    Units are told three ways, since programs differ in which they believe: dataset 164, the data type and the label.
    Raises MeasurementError for peaks, fingers and several actuators at once, which the form cannot hold.
    """
    moving = abs(measurements.amplitude) > 0
    if measurements.kind is not Kind.RESPONSE or (moving.sum(axis=1) > 1).any():
        raise MeasurementError(f"{path}: a universal file holds complex responses of one actuator each; write .csv")
    if (~np.isnan(measurements.finger_m)).any():
        raise MeasurementError(f"{path}: a universal file has no finger on the bar; write .csv")
    rows, which = np.arange(len(measurements)), moving.argmax(axis=1)
    hz = measurements.frequency_hz[rows, which]
    unit = measurements.acceleration / measurements.amplitude[rows, which]
    place_m = np.unique(measurements.position_m)
    base_m = np.array([actuator.position_m for actuator in device.actuators])
    node_m = np.concatenate([place_m, base_m])
    number, none = np.arange(1, len(node_m) + 1), np.zeros(len(node_m))
    units = {"type": _UNITS, "units_code": _SI_UNITS, "units_description": "SI", "temp_mode": 1}
    factors = dict.fromkeys(("length", "force", "temp"), 1.0) | {"temp_offset": 273.15}
    nodes = {"type": 15, "node_nums": number, "def_cs": none + 1, "disp_cs": none + 1, "color": none + 1}
    sets: list[dict[str, Any]] = [units | factors, nodes | {"x": node_m.real, "y": node_m.imag, "z": none}]
    words = comment if not measurements.is_simulated or SIMULATED in comment else f"{SIMULATED}: {comment}"
    text = " ".join(words.split())[:_LONGEST_LINE]
    for actuator in np.unique(which).tolist():
        for place in range(len(place_m)):
            chosen = np.flatnonzero((which == actuator) & (measurements.position_m == place_m[place]))
            chosen = chosen[np.argsort(hz[chosen])]
            if len(chosen) == 1:
                raise MeasurementError(f"{path}: a response of one frequency is none for this form; write .csv")
            if len(chosen):
                nodes_of = (place + 1, len(place_m) + actuator + 1)
                sets.append(_response_set(hz[chosen], unit[chosen], *nodes_of, text))
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")


def _response_set(hz: Any, acceleration: Any, response_node: int, reference_node: int, text: str) -> dict[str, Any]:
    """A dataset 58: acceleration (line,) over frequencies that need not be even; pyuff fills in what is not used."""
    response = {"func_type": _FREQUENCY_RESPONSE, "ord_data_type": 6, "abscissa_spacing": 0, "id1": text}
    places = {"rsp_node": response_node, "rsp_dir": _ACROSS, "ref_node": reference_node, "ref_dir": _ACROSS}
    out: dict[str, Any] = {"type": _RESPONSES, **response, **places, "orddenom_spec_data_type": 0}
    for axis, (kind, label, unit) in {
        "abscissa": (_FREQUENCY, "Frequency", "Hz"),
        "ordinate": (_ACCELERATION, "Acceleration", "m/s^2"),
    }.items():
        out |= {f"{axis}_spec_data_type": kind, f"{axis}_axis_lab": label, f"{axis}_axis_units_lab": unit}
    return out | {"data": acceleration, "x": hz}


def _unit_of(part: Mapping[str, Any], key: str, path: Path) -> float:
    """The file's unit of length or force in SI: its factor leads from SI to what is written."""
    factor = float(part[key])
    if not 0 < factor < np.inf:
        raise MeasurementError(f"{path}: dataset 164: factor of {key} {factor:g}: expected more than 0, 1 for SI")
    return 1 / factor


def _read_nodes(sets: Sequence[Mapping[str, Any]], path: Path, *, is_plate: bool) -> dict[int, complex]:
    """Place along the bar, or point of the plate, in the file's unit, by node number."""
    places: dict[int, complex] = {}
    for number, part in enumerate(sets, 1):
        if part["type"] in _NODES:
            numbers, x = np.atleast_1d(part["node_nums"]), np.atleast_1d(part["x"])
            x = x + 1j * np.atleast_1d(part["y"]) if is_plate else x
            if len(numbers) != len(x) or not (np.isfinite(numbers).all() and np.isfinite(x).all()):
                raise MeasurementError(f"{path}: dataset {number}: expected a number and a place of each node")
            places |= dict(zip(numbers.astype(int).tolist(), x.tolist(), strict=True))
    return places


class _Row(NamedTuple):
    """A response: places of sensor and reference in metres, frequencies in Hz (line,), m/s^2 or m/s^2/N (line,)."""

    position_m: complex
    reference_m: complex
    frequency_hz: Any
    acceleration: Any
    is_per_newton: bool


def _read_response(
    part: Mapping[str, Any], place_m: Mapping[int, complex], units: tuple[float, float], device: Device, where: str
) -> _Row:
    """The response of a dataset 58; `units` of length and force are those of the file, in SI."""
    expected = (
        ("func_type", _FREQUENCY_RESPONSE, "a frequency response, 4"),
        ("abscissa_spec_data_type", _FREQUENCY, "a frequency, 18"),
    )
    for key, wanted, text in expected:
        if int(part.get(key) or 0) != wanted:
            raise MeasurementError(f"{where}: {key}: {part.get(key)}: expected {text}")
    _check_kind(part, where)
    for key in ("rsp_node", "ref_node"):
        if int(part[key]) not in place_m:
            raise MeasurementError(f"{where}: {key}: node {part[key]} has no place; give it in a dataset 15 or 2411")
    unit = _response_unit(part, units, where)
    scale = unit.scale
    for key in ("rsp_dir", "ref_dir"):
        scale *= -1.0 if int(part.get(key) or _UNSAID) == -_ACROSS else 1.0
    base_m = place_m[int(part["ref_node"])]
    off_m = min(abs(actuator.position_m - base_m) for actuator in device.actuators)
    if not unit.is_per_newton and off_m > AT_ACTUATOR * device.surface.length_m:
        text = f"{point_text(base_m)}: is where no actuator is; they are {text_of_places(device)}"
        raise MeasurementError(f"{where}: ref_node: {text}")
    count = int(part["num_pts"])  # the last line may be filled up with zeros
    hz = _unit(part, "abscissa_axis_units_lab", "Hz", 1.0, where) * np.asarray(part["x"], dtype=np.float64)[:count]
    value = scale * np.asarray(part["data"], dtype=np.complex128)[:count]
    if not len(hz) == len(value) == count:
        raise MeasurementError(f"{where}: num_pts: {count}: the dataset has {min(len(hz), len(value))} values")
    acceleration = to_acceleration(value, unit.order, hz)
    return _Row(place_m[int(part["rsp_node"])], base_m, hz[hz > 0], acceleration[hz > 0], unit.is_per_newton)


def _check_kind(part: Mapping[str, Any], where: str) -> None:
    """Refuse a dataset that is no complex response in the direction of bending."""
    if int(part["ord_data_type"]) not in _COMPLEX:
        text = "a response is complex, 5 or 6; magnitudes alone have no phase"
        raise MeasurementError(f"{where}: ord_data_type: {part['ord_data_type']}: {text}")
    for key in ("rsp_dir", "ref_dir"):
        if abs(direction := int(part.get(key) or _UNSAID)) not in (_ACROSS, _UNSAID):
            text = "expected 3 or -3, across the surface (z), where bending is"
            raise MeasurementError(f"{where}: {key}: {direction}: {text}")


def _response_unit(part: Mapping[str, Any], units: tuple[float, float], where: str) -> ResponseUnit:
    """What the ordinate is by its type, by that of its denominator and by both labels, which must agree.

    The label of the ordinate may be that of the whole, m/s^2/N, or that above the stroke, with N in the denominator's.
    """
    unit_m, unit_n = units
    kind, per = (int(part.get(f"{axis}_spec_data_type") or 0) for axis in ("ordinate", "orddenom"))
    if kind not in _ORDERS and kind not in _UNTOLD:
        text = "expected an acceleration, 12, a velocity, 11, or a displacement, 8"
        raise MeasurementError(f"{where}: ordinate_spec_data_type: {kind}: {text}")
    if per not in (_FORCE, *_UNTOLD):
        text = f"the response is per {_DENOMINATORS.get(per, 'another quantity')}; expected 0, the response to the "
        text += "actuator at full scale, or 13, per excitation force; multiply it by what full scale is"
        raise MeasurementError(f"{where}: orddenom_spec_data_type: {per}: {text}")
    label, below = _label(part, "ordinate"), _label(part, "orddenom")
    if not label and kind in _UNTOLD:
        text = "says no quantity, nor does ordinate_axis_units_lab; expected an acceleration, 12"
        raise MeasurementError(f"{where}: ordinate_spec_data_type: {kind}: {text}")
    try:
        unit = read_response_unit(label) if label else ResponseUnit(unit_m, _ORDERS[kind], is_per_newton=False)
    except QuantityError as error:
        raise MeasurementError(f"{where}: ordinate_axis_units_lab: {error}") from None
    if _ORDERS.get(kind, unit.order) != unit.order:
        text = f"{label!r} is the unit of {unit.quantity}, and ordinate_spec_data_type is {kind}; correct one of them"
        raise MeasurementError(f"{where}: ordinate_axis_units_lab: {text}")
    force_n = _unit(part, "orddenom_axis_units_lab", "N", unit_n, where)
    says_force = per == _FORCE or below or int(part.get("ordinate_force_unit_exp") or 0) == -1
    if unit.is_per_newton or not says_force:
        return unit
    return unit._replace(scale=unit.scale / force_n, is_per_newton=True)


def _label(part: Mapping[str, Any], axis: str) -> str:
    """The unit that an axis names; empty where it names none."""
    text = str(part.get(f"{axis}_axis_units_lab") or "").strip()
    return "" if text.upper() == "NONE" else text


def _unit(part: Mapping[str, Any], key: str, unit: str, unlabelled: float, where: str) -> float:
    """Factor from the values of an axis to a unit; `unlabelled` where the file does not name its own."""
    text = _label(part, key.removesuffix("_axis_units_lab")).strip("()")
    if not text:
        return unlabelled
    try:
        return unit_scale(text, unit)
    except QuantityError as error:
        raise MeasurementError(f"{where}: {key}: {error}") from None
