"""A unit's measurements to its calibrated device, with raw data and report in a folder that is whole or not there."""

import hashlib
import json
from pathlib import Path

from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.files import write_new_folder
from precompute.calibration.calibrate import Calibration, calibrate
from precompute.calibration.device_text import calibrated_text
from precompute.calibration.misfit import Loss
from precompute.calibration.pairwise import fit_pairwise
from precompute.calibration.report import calibration_report, report_markdown
from precompute.fleet.units import Job
from precompute.measurements.file import read_measurements
from precompute.measurements.parameters import default_names

LARGEST_MISFIT = 0.2
"""A greater typical misfit is a doubt, as for `tactable calibrate`."""
_REPORT = "report.json"


def calibrate_unit(job: Job, device: Device, path: Path) -> tuple[Device, tuple[str, ...]]:
    """The calibrated device, and what is doubtful of it. A calibration of the same inputs that is there is taken.

    Raises CalibrationError for measurements and parameters that cannot be used.
    """
    folder = job.folder / f"calibration-{job.key[:12]}"
    if not folder.exists():
        write_new_folder(folder, _files(job, device, path))
    calibrated = Device.read(folder / f"{device.name}.toml")
    report = json.loads((folder / _REPORT).read_text(encoding="utf-8"))
    misfit = report["median_misfit"]
    doubts = [f"typical misfit {100 * misfit:.3g} %"] if misfit > LARGEST_MISFIT else []
    doubts += [f"{p['name']}: {p['known']}" for p in report["parameters"] if p["known"] != "known"]
    return calibrated, tuple(doubts)


def _files(job: Job, device: Device, path: Path) -> dict[str, bytes]:
    raw, recipe = path.read_bytes(), job.recipe
    measurements = read_measurements(path, device, recipe.sensor_mass_kg)
    names = (*(default_names(device) if recipe.parameters is None else recipe.parameters), *recipe.also)
    with threadpool_limits(1, "blas"):
        found = calibrate(device, measurements, names, Loss(recipe.loss))
        report = calibration_report(found, fit_pairwise(device, found))
    return {
        f"{device.name}.toml": _text(found, job, path, raw).encode(),
        f"measurements{path.suffix.lower()}": raw,
        _REPORT: json.dumps(report, indent=2).encode(),
        "report.md": report_markdown(report).encode(),
    }


def _text(found: Calibration, job: Job, path: Path, raw: bytes) -> str:
    provenance = {
        "created": job.created,
        "measurements": f"measurements{path.suffix.lower()}",
        "sha256": hashlib.sha256(raw).hexdigest(),
        "report": _REPORT,
        "loss": found.loss.value,
    }
    return calibrated_text(found, provenance)
