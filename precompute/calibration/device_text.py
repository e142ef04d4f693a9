"""Texts of device files with the values of a calibration or with measured transfer functions, comments kept."""

from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit

from engine.device import Device, Transfer
from engine.device.named_files import tables_of
from engine.device.quantity import quantity_text
from precompute.calibration.calibrate import FittedDevice

_DIGITS = 10  # finer than any interval, and still short
_LEAST_DAMPING = "1e-9 s"
"""The least that a file may state of the surface's stiffness damping."""


def calibrated_text(calibration: FittedDevice, provenance: Mapping[str, str]) -> str:
    """The description with the fitted values, which are no longer marked as estimates.

    Its table [calibration] states which values were fitted and their covariance, and holds `provenance` (created,
    measurements, sha256, report) unchanged.
    """
    document = tomlkit.parse(calibration.device.text)
    for estimate in calibration.estimates:
        parameter = estimate.parameter
        if parameter.part == "sensor":
            continue
        tables, key = tables_of(document, parameter.name, calibration.device.name)
        for table in tables:
            table[key] = quantity_text(estimate.value, parameter.unit, _DIGITS)
            marks = table.get("inferred")
            if marks is not None and key in marks:
                marks.remove(key)
    _keep_damped(document, calibration.device)
    document["calibration"] = _calibration_table(calibration, provenance)
    return tomlkit.dumps(document)


def _keep_damped(document: tomlkit.TOMLDocument, device: Device) -> None:
    """State the least damping where all are 0: such a file would be refused, and what was fitted would be lost."""
    own = f"{device.surface.kind}.stiffness_damping"
    dampings = (f"{device.surface.kind}.mass_damping", own, "actuator.damping")
    found = [tables_of(document, damping, device.name) for damping in dampings]
    if not any(float(str(table.get(key, "0")).split()[0]) for tables, key in found for table in tables):
        tables, key = tables_of(document, own, device.name)
        tables[0][key] = _LEAST_DAMPING


def text_with_transfers(device: Device, transfers: Sequence[Transfer]) -> str:
    """The description with a transfer function for every actuator, in place of those it has."""
    document = tomlkit.parse(device.text)
    tables = tables_of(document, "actuator.transfer", device.name)[0]
    for table, transfer in zip(tables, transfers, strict=True):
        points = tomlkit.array()
        for hz, size, deg in zip(transfer.frequency_hz, transfer.magnitude, transfer.phase_deg, strict=True):
            points.add_line([f"{hz:.10g} Hz", f"{100 * size:.4g} %", f"{deg:.4g} deg"])
        points.add_line(indent="")
        table["transfer"] = points
    return tomlkit.dumps(document)


def calibrated_device(calibration: FittedDevice) -> Device:
    """The device with the fitted values, and a text that states them: to build a table from, or to write to a file."""
    return Device.parse(calibrated_text(calibration, {}), calibration.device.name)


def _calibration_table(calibration: FittedDevice, provenance: Mapping[str, str]) -> Any:
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
