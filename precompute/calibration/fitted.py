"""A file of measurements to a fit with its report, and to the contents of the folder that keeps them."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from engine.device import Device
from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.calibrate import STARTS, FittedDevice, calibrate, names_told
from precompute.calibration.calibration_report import calibration_report, report_markdown
from precompute.calibration.device_text import calibrated_text
from precompute.calibration.modal_fit import calibrate_modes, modal_report
from precompute.measurements.measured_modes import read_modes
from precompute.measurements.measurement_file import check_file, read_measurements
from precompute.measurements.parameters import Bounds

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
