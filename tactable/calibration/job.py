"""A calibration as it was asked for: fitted and written to its folder, or found there from before."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.device import Device
from engine.files import check_new_folder, write_new_folder
from precompute.calibration.misfit import Loss
from precompute.measurements.parameters import Bounds
from tactable.step_times import Progress

if TYPE_CHECKING:
    from precompute.calibration.calibrate import Calibration

_REPORT = "report.json"


@dataclass(frozen=True)
class CalibrationJob:
    """What the command was asked for; `bounds` are SI."""

    device: Device
    measurements: Path
    folder: Path
    names: tuple[str, ...]
    bounds: Mapping[str, Bounds]
    loss: Loss
    sensor_mass_kg: float
    starts: int
    seed: int
    compares: bool

    @property
    def device_file(self) -> Path:
        """Where the calibrated device is written."""
        return self.folder / f"{self.device.name}.toml"

    def fit(self, progress: Progress) -> "Fitted":
        """Read and fit. Raises CalibrationError and its kin, and where the folder is there already."""
        from threadpoolctl import threadpool_limits

        from precompute.calibration.calibrate import calibrate
        from precompute.calibration.pairwise import fit_pairwise
        from precompute.calibration.report import calibration_report
        from precompute.measurements import read_measurements

        check_new_folder(self.folder)
        raw = self.measurements.read_bytes()
        progress("fit", 0.0)
        with threadpool_limits(1, "blas"):
            measurements = read_measurements(self.measurements, self.device, self.sensor_mass_kg)
            found = calibrate(
                self.device,
                measurements,
                self.names,
                self.loss,
                bounds=self.bounds,
                starts=self.starts,
                seed=self.seed,
            )
            report = calibration_report(found, fit_pairwise(self.device, found) if self.compares else None)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return Fitted(found, report | {"asked": self._asked(raw)}, raw, self.measurements.suffix.lower(), now)

    def write(self, fitted: "Fitted") -> None:
        """Write the folder. Raises FolderError."""
        from tactable.calibration.files import calibration_files

        files = calibration_files(fitted.calibration, fitted.report, fitted.raw, fitted.ending, fitted.created)
        write_new_folder(self.folder, files)

    def kept_report(self) -> dict[str, Any] | None:
        """The report of the same calibration, asked for before; None where the folder holds none, or another."""
        try:
            report: dict[str, Any] = json.loads((self.folder / _REPORT).read_text(encoding="utf-8"))
            raw = self.measurements.read_bytes()
        except (OSError, ValueError):
            return None
        return report if report.get("asked") == self._asked(raw) and self.device_file.is_file() else None

    def _asked(self, raw: bytes) -> dict[str, Any]:
        """All that decides the result, for JSON."""
        return {
            "device_sha256": hashlib.sha256(self.device.text.encode()).hexdigest(),
            "measurements_sha256": hashlib.sha256(raw).hexdigest(),
            "names": list(self.names),
            "bounds": {name: list(ends) for name, ends in self.bounds.items()},
            "loss": self.loss.value,
            "sensor_mass_kg": self.sensor_mass_kg,
            "starts": self.starts,
            "seed": self.seed,
        }


@dataclass(frozen=True)
class Fitted:
    """What was found, not written yet; `raw` is the file of measurements, `ending` such as ".csv"."""

    calibration: "Calibration"
    report: dict[str, Any]
    raw: bytes
    ending: str
    created: str

    def device(self, source: str) -> Device:
        """The device of the file that will be written; `source` is its name in messages."""
        from tactable.calibration.files import device_text

        return Device.parse(device_text(self.calibration, self.raw, self.ending, self.created), source)


def calibration_json(job: CalibrationJob, report: Mapping[str, Any], doubts: Sequence[str]) -> dict[str, Any]:
    """For machines."""
    return {"folder": str(job.folder), "device_file": str(job.device_file), "doubts": list(doubts), **report}
