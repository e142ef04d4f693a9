"""A calibration as it was asked for: fitted and written to a folder, or found there from an earlier run.

The folder holds the new device file, the raw measurements, the report and a picture of the fit. It appears whole or
not at all, and its report keeps everything that decided the result, so that the same job finds it again.
"""

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from base.files import check_new_folder, write_new_folder
from engine.device import Device
from engine.render.board_fit import card_text, flash_text
from precompute.calibration.adequacy import doubts_of
from precompute.calibration.fitted import REPORT, Fitted, calibrated_device, fit_file
from precompute.measurements.parameters import Bounds

Progress = Callable[[str, float], None]


class StepTimes:
    """Seconds by step, from its creation on; a step ends when another one is reported."""

    def __init__(self, show: Progress, step: str, clock_s: Callable[[], float] = time.perf_counter) -> None:
        self._show, self._step, self._clock_s = show, step, clock_s
        self._start_s = self._since_s = clock_s()
        self._seconds: dict[str, float] = {}

    def tell_step(self, step: str, fraction: float) -> None:
        """Report the present step and the fraction done, and pass both on."""
        self._show(step, fraction)
        if step != self._step:
            self._end_step()
            self._step = step

    def read(self) -> dict[str, float]:
        """Seconds of every step so far, the present one included, in the order of their beginning."""
        self._end_step()
        return dict(self._seconds)

    @property
    def total_s(self) -> float:
        """Seconds since its creation."""
        return self._clock_s() - self._start_s

    def _end_step(self) -> None:
        now_s = self._clock_s()
        self._seconds[self._step] = self._seconds.get(self._step, 0.0) + now_s - self._since_s
        self._since_s = now_s


def times_text(seconds: dict[str, float]) -> str:
    """The times in words, such as "fit 0.7 s, sweep 0.9 s"; steps of no time are left out."""
    return ", ".join(f"{step} {value:.2g} s" for step, value in seconds.items() if value >= 0.01)


@dataclass(frozen=True)
class CalibrationJob:
    """All that decides a calibration; `bounds` in SI units."""

    device: Device
    measurements: Path
    folder: Path
    names: tuple[str, ...]
    bounds: Mapping[str, Bounds]
    sensor_mass_kg: float
    starts: int
    seed: int
    accepted_misfit: float
    is_strict: bool  # a parameter that is not known within a factor of 2 makes the result doubtful
    is_modes: bool = False  # the measurements are modes

    @property
    def device_file(self) -> Path:
        """File of the calibrated device."""
        return self.folder / f"{self.device.name}.toml"

    def fit(self, progress: Progress) -> Fitted:
        """Read the measurements and fit. Raises CalibrationError, FolderError where the folder is there already."""
        check_new_folder(self.folder)
        progress("fit", 0.0)
        fitted = fit_file(
            self.device,
            self.measurements,
            self.names,
            sensor_mass_kg=self.sensor_mass_kg,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            bounds=self.bounds,
            starts=self.starts,
            seed=self.seed,
            is_modes=self.is_modes,
        )
        report = fitted.report | {"asked": self._asked(fitted.raw)}
        if any(p["name"].endswith("full_scale") for p in report["parameters"]):
            device = calibrated_device(fitted.calibration)
            report |= {"flash": flash_text(device), "card": card_text(device)}
        return replace(fitted, report=report)

    def write(self, fitted: Fitted) -> None:
        """Write the folder. Raises FolderError."""
        from tactable.figures.calibration import calibration_png  # takes a second to import, which a refusal need not

        write_new_folder(self.folder, fitted.files() | {"fit.png": calibration_png(fitted.calibration)})

    def doubts_of(self, report: Mapping[str, Any]) -> list[str]:
        """Reasons not to use the result without a look."""
        return doubts_of(report, self.accepted_misfit, is_strict=self.is_strict)

    def kept_report(self) -> dict[str, Any] | None:
        """Report of an earlier run of the same job; None where the folder holds none, or that of another job."""
        try:
            report: dict[str, Any] = json.loads((self.folder / REPORT).read_text(encoding="utf-8"))
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
            "sensor_mass_kg": self.sensor_mass_kg,
            "starts": self.starts,
            "seed": self.seed,
            **({"is_modes": True} if self.is_modes else {}),
        }


def calibration_json(job: CalibrationJob, report: Mapping[str, Any], doubts: Sequence[str]) -> dict[str, Any]:
    """Calibration as plain values: files, doubts and the report."""
    return {"folder": str(job.folder), "device_file": str(job.device_file), "doubts": list(doubts), **report}
