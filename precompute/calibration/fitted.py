"""A file of measurements to a fit with its report, and to the texts of device files and the folder that keep them."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from threadpoolctl import threadpool_limits

from engine.device import Device, Transfer
from engine.device.named_files import tables_of
from engine.device.quantity import quantity_text
from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.calibrate import STARTS, FittedDevice, calibrate, names_told
from precompute.calibration.calibration_report import calibration_report, report_markdown
from precompute.calibration.modal_fit import calibrate_modes, modal_report
from precompute.measurements.measured_modes import read_modes
from precompute.measurements.measurement_file import check_file, read_measurements
from precompute.measurements.parameters import Bounds

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


REPORT = "report.json"


@dataclass(frozen=True)
class Fitted:
    """A calibration that is not written yet; `raw` is the file of measurements, `ending` such as ".csv"."""

    calibration: FittedDevice
    report: dict[str, Any]
    raw: bytes
    ending: str
    created: str

    def device(self, source: str) -> Device:
        """Device of the file that will be written; `source` is its name in messages."""
        return Device.parse(self._device_text, source)

    def files(self) -> dict[str, bytes]:
        """Contents of the folder by name: device file, measurements, and the report for machines and for people."""
        name = self.calibration.device.name
        more = {**self._provenance, "fingerprint": self.device(name).fingerprint}
        return {
            f"{name}.toml": self._device_text.encode(),
            self._data_name: self.raw,
            REPORT: json.dumps({**self.report, **more}, indent=2).encode(),
            "report.md": report_markdown(self.report).encode(),
        }

    @property
    def _device_text(self) -> str:
        return calibrated_text(self.calibration, self._provenance)

    @property
    def _provenance(self) -> dict[str, str]:
        return {
            "created": self.created,
            "measurements": self._data_name,
            "sha256": hashlib.sha256(self.raw).hexdigest(),
            "report": REPORT,
        }

    @property
    def _data_name(self) -> str:
        return f"measurements{self.ending}"


def fit_file(
    device: Device,
    path: Path,
    names: Sequence[str],
    *,
    sensor_mass_kg: float,
    created: str,
    bounds: Mapping[str, Bounds],
    starts: int = STARTS,
    seed: int = 0,
    is_modes: bool = False,
) -> Fitted:
    """Fit a device to a file of measurements, or of modes alone.

    Raises CalibrationError; OSError where the file cannot be read.
    """
    check_file(path)
    raw = path.read_bytes()
    if is_modes:
        modal = calibrate_modes(
            device, read_modes(path, device, sensor_mass_kg), names, bounds=bounds, starts=starts, seed=seed
        )
        return Fitted(modal, modal_report(modal), raw, path.suffix.lower(), created)
    with threadpool_limits(1, "blas"):
        measurements = read_measurements(path, device, sensor_mass_kg)
        names = names_told(measurements, names)
        found = calibrate(device, measurements, names, bounds=bounds, starts=starts, seed=seed)
        report = calibration_report(found)
        report["adequacy"] = adequacy_report(device, found, bounds)
    return Fitted(found, report, raw, path.suffix.lower(), created)
