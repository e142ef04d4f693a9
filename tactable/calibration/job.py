"""A calibration as it was asked for: fitted and written to a folder, or found there from an earlier run.

The folder holds the new device file, the raw measurements, the report and a picture of the fit. It appears whole or
not at all, and its report keeps everything that decided the result, so that the same job finds it again.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from base.files import check_new_folder, write_new_folder
from engine.device import Device
from engine.render.board_fit import card_text, flash_text
from precompute.calibration.device_text import calibrated_text
from precompute.calibration.misfit import Loss
from precompute.calibration.plausibility import implausible_changes
from precompute.measurements.parameters import Bounds
from tactable.calibration.step_times import Progress

if TYPE_CHECKING:
    from precompute.calibration.calibrate import Calibration

_REPORT = "report.json"


@dataclass(frozen=True)
class CalibrationJob:
    """All that decides a calibration; `bounds` in SI units."""

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
    """Also fit as the paper does: each drive alone, then the mean."""
    accepted_misfit: float
    is_strict: bool
    """A parameter that is not known within a factor of 2 makes the result doubtful."""

    @property
    def device_file(self) -> Path:
        """File of the calibrated device."""
        return self.folder / f"{self.device.name}.toml"

    def fit(self, progress: Progress) -> "Fitted":
        """Read the measurements and fit. Raises CalibrationError, FolderError where the folder is there already."""
        from threadpoolctl import threadpool_limits

        from precompute.calibration.adequacy import adequacy_report
        from precompute.calibration.calibrate import calibrate
        from precompute.calibration.device_text import calibrated_device
        from precompute.calibration.pairwise import fit_pairwise
        from precompute.calibration.report import calibration_report
        from precompute.measurements import read_measurements
        from precompute.measurements.file import check_file

        check_new_folder(self.folder)
        check_file(self.measurements)
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
            report["adequacy"] = adequacy_report(self.device, found, self.bounds)
        if any(p["name"].endswith("full_scale") for p in report["parameters"]):
            report["flash"] = flash_text(calibrated_device(found))
            report["card"] = card_text(calibrated_device(found))
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return Fitted(found, report | {"asked": self._asked(raw)}, raw, self.measurements.suffix.lower(), now)

    def write(self, fitted: "Fitted") -> None:
        """Write the folder. Raises FolderError."""
        write_new_folder(self.folder, calibration_files(fitted))

    def doubts_of(self, report: Mapping[str, Any]) -> list[str]:
        """Reasons not to use the result without a look."""
        adequacy = report.get("adequacy", {})
        if adequacy.get("is_turned"):
            return [adequacy["doubt"]]
        doubts, misfit = [], report["median_misfit"]
        if misfit > self.accepted_misfit:
            doubts.append(f"the typical misfit, {100 * misfit:.3g} %, is above {100 * self.accepted_misfit:g} %")
        if doubt := adequacy.get("doubt"):
            doubts.append(doubt)
        doubts += implausible_changes(report["parameters"])
        if self.is_strict:
            unsure = [p["name"] for p in report["parameters"] if p["known"] != "known"]
            doubts += [f"{name} is not known within a factor of 2" for name in unsure]
        return doubts

    def kept_report(self) -> dict[str, Any] | None:
        """Report of an earlier run of the same job; None where the folder holds none, or that of another job."""
        try:
            report: dict[str, Any] = json.loads((self.folder / _REPORT).read_text(encoding="utf-8"))
            raw = self.measurements.read_bytes()
        except (OSError, ValueError):
            return None
        return report if report.get("asked") == self._asked(raw) and self.device_file.is_file() else None

    def _asked(self, raw: bytes) -> dict[str, Any]:
        """Values that decide the result, for JSON."""
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
    """A calibration that is not written yet; `raw` is the file of measurements, `ending` such as ".csv"."""

    calibration: "Calibration"
    report: dict[str, Any]
    raw: bytes
    ending: str
    created: str

    def device(self, source: str) -> Device:
        """Device of the file that will be written; `source` is its name in messages."""
        return Device.parse(_device_text(self), source)


def calibration_json(job: CalibrationJob, report: Mapping[str, Any], doubts: Sequence[str]) -> dict[str, Any]:
    """Calibration as plain values: files, doubts and the report."""
    return {"folder": str(job.folder), "device_file": str(job.device_file), "doubts": list(doubts), **report}


def calibration_files(fitted: Fitted) -> dict[str, bytes]:
    """Contents of the folder by name."""
    from precompute.calibration.report import report_markdown
    from tactable.figures.calibration import calibration_png  # takes a second to import; the device file does not wait

    name = fitted.calibration.device.name
    text = _device_text(fitted)
    more = {**_provenance(fitted), "fingerprint": Device.parse(text, name).fingerprint}
    return {
        f"{name}.toml": text.encode(),
        _data_name(fitted): fitted.raw,
        _REPORT: json.dumps({**fitted.report, **more}, indent=2).encode(),
        "report.md": report_markdown(fitted.report).encode(),
        "fit.png": calibration_png(fitted.calibration),
    }


def _device_text(fitted: Fitted) -> str:
    return calibrated_text(fitted.calibration, _provenance(fitted))


def _provenance(fitted: Fitted) -> dict[str, str]:
    return {
        "created": fitted.created,
        "measurements": _data_name(fitted),
        "sha256": hashlib.sha256(fitted.raw).hexdigest(),
        "report": _REPORT,
        "loss": fitted.calibration.loss.value,
    }


def _data_name(fitted: Fitted) -> str:
    return f"measurements{fitted.ending}"
