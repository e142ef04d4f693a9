"""Texts of device files with other values, comments and order kept: values by key, or those of a calibration."""

import re
from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.exceptions import ParseError

from engine.device import Device, DeviceError
from engine.device.quantity import quantity_text
from precompute.calibration.calibrate import Calibration

_KEY = re.compile(r"(?:(\w+)(?:\[([1-9]\d{0,2})\])?\.)?(\w+)")
_DIGITS = 10


def text_with_values(text: str, values: Mapping[str, str], source: str) -> str:
    """Text with `values` by key: bar.thickness, actuator[2].mass, or actuator.mass for every actuator.

    Whether a key exists and a value is valid shows when the text is read. Raises DeviceError.
    """
    if not values:
        return text
    try:
        document = tomlkit.parse(text)
    except ParseError as error:
        raise DeviceError(f"{source}: not TOML: {error}") from error
    for key, value in values.items():
        tables, last = _tables(document, key, source)
        for table in tables:
            table[last] = int(value) if value.isdigit() else value
    return tomlkit.dumps(document)


def calibrated_text(calibration: Calibration, provenance: Mapping[str, str]) -> str:
    """The description with the fitted values, which are no longer marked as estimates.

    Its table [calibration] states which values were fitted and their covariance, and holds `provenance` (created,
    measurements, sha256, report, loss) unchanged.
    """
    document = tomlkit.parse(calibration.device.text)
    for estimate in calibration.estimates:
        parameter = estimate.parameter
        if parameter.part == "sensor":
            continue
        tables, key = _tables(document, parameter.name, calibration.device.name)
        for table in tables:
            table[key] = quantity_text(estimate.value, parameter.unit, _DIGITS)
            marks = table.get("inferred")
            if marks is not None and key in marks:
                marks.remove(key)
    document["calibration"] = _calibration_table(calibration, provenance)
    return tomlkit.dumps(document)


def calibrated_device(calibration: Calibration) -> Device:
    """The device with the fitted values, and a text that states them: to build a table from, or to write to a file."""
    return Device.parse(calibrated_text(calibration, {"loss": calibration.loss.value}), calibration.device.name)


def _tables(document: Any, key: str, source: str) -> tuple[list[Any], str]:
    """The TOML tables that a key addresses, and its last part."""
    match = _KEY.fullmatch(key)
    if match is None:
        raise DeviceError(f"{source}: {key!r}: expected a key such as bar.thickness or actuator[1].stiffness")
    part, index, last = match.groups()
    if part is None:
        return [document], last
    found = document.get(part)
    tables = found if isinstance(found, list) else [found]
    if index is not None:
        tables = tables[int(index) - 1 : int(index)] if isinstance(found, list) else []
    if not tables or not all(isinstance(table, dict) for table in tables):
        raise DeviceError(f"{source}: {key}: the description has no such table")
    return tables, last


def _calibration_table(calibration: Calibration, provenance: Mapping[str, str]) -> Any:
    table = tomlkit.table()
    for key, text in provenance.items():
        table[key] = text
    uncertainty = calibration.uncertainty
    covariance = tomlkit.array()
    for row in uncertainty.covariance:
        covariance.add_line([float(value) for value in row])
    covariance.add_line(indent="")
    table["covariance"] = covariance
    fitted = tomlkit.aot()
    units = {parameter.name: parameter.unit for parameter in calibration.parameters}
    for value in uncertainty.fitted:
        entry = tomlkit.table()
        entry["name"] = value.name
        for key in ("low", "high", *(("knee",) if value.knee else ())):
            entry[key] = quantity_text(getattr(value, key), units[value.name], _DIGITS)
        fitted.append(entry)
    table["fitted"] = fitted
    return table
