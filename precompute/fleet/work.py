"""Work on one unit in its folder: calibrate, build, verify. Its outcome is written last and marks it as complete."""

import json
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
from threadpoolctl import threadpool_limits

from base.errors import TactableError
from base.files import remove_partials, replace_file, write_new_folder
from engine.device import Device, DeviceError
from engine.device.texts import text_with_values
from engine.device.toml_table import read_text
from engine.device.values import device_values
from engine.table import Table
from engine.table.netcdf_file import file_checksum
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.table_build import Progress, build_table, no_progress
from precompute.calibration.fitted import REPORT, fit_file
from precompute.clicks import ClickOptions
from precompute.fleet.figures import compute_table_figures, evaluate_table
from precompute.fleet.units import FleetError, Job, Outcome
from precompute.measurements.parameters import default_names

TABLE = "table.nc"
DEVICE = "device.toml"
OUTCOME = "outcome.json"
_JUDGED = ("parameters", "adequacy", "readings", "median_misfit", "noise", "wrong_readings")

# Two threads that enter numba's parallel kernels at once abort the process.
_one_at_a_time = threading.Lock()


def run_in_worker(job: Job) -> Outcome:
    """Run a job on one thread; a process runs one job at a time."""
    with _one_at_a_time:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        try:
            done = kept_outcome(job)  # written by a worker that was killed before it could return it
            return run_job(job) if done is None else replace(done, is_kept=False)
        finally:
            numba.set_num_threads(threads)


def run_job(job: Job, progress: Progress = no_progress) -> Outcome:
    """Calibrate, build and verify a unit; an error becomes part of the outcome."""
    start_s = time.perf_counter()
    try:
        outcome = _run(job, progress)
    except Exception as error:  # one bad unit must not stop the others
        outcome = Outcome(job.unit.name, job.key, error=describe_error(error))
    return replace(outcome, seconds=time.perf_counter() - start_s)


def describe_error(error: Exception) -> str:
    """The error in one line, with its type unless it is meant for users."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    is_ours = isinstance(error, TactableError | ValueError | OSError)
    text = " ".join(str(error).split())
    return text if is_ours and text else f"{type(error).__name__}: {text}"


def kept_outcome(job: Job) -> Outcome | None:
    """The outcome of an earlier run, if its key is the same and its table unchanged."""
    try:
        values = json.loads((job.folder / OUTCOME).read_text(encoding="utf-8"))
        outcome = Outcome(**{**values, "report": values["report"], "is_kept": True})
        is_whole = outcome.key == job.key and (
            outcome.table_crc32 is None or outcome.table_crc32 == file_checksum(job.folder / TABLE)
        )
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return outcome if is_whole else None


def _run(job: Job, progress: Progress) -> Outcome:
    if job.code_fingerprint != code_fingerprint():
        raise FleetError("this worker has another version of tactable; install the same everywhere")
    job.folder.mkdir(parents=True, exist_ok=True)
    (job.folder / OUTCOME).unlink(missing_ok=True)
    for name in (DEVICE, OUTCOME):
        remove_partials(job.folder / name)
    device, report = _prepare(job, progress)
    with replace_file(job.folder / DEVICE) as partial:
        partial.write_text(device.text, encoding="utf-8")
    table_crc32 = None
    if job.unit.evaluated_table is None:
        figures = _build(job, device, progress)
        table_crc32 = file_checksum(job.folder / TABLE)
    else:
        with Table.open(job.unit.evaluated_table) as table, threadpool_limits(1, "blas"):
            figures = evaluate_table(table, device)
    outcome = Outcome(
        name=job.unit.name,
        key=job.key,
        fingerprint=device.fingerprint,
        table_crc32=table_crc32,
        values=device_values(device),
        figures=figures,
        report=report,
    )
    with replace_file(job.folder / OUTCOME) as partial:
        partial.write_text(outcome.as_json(), encoding="utf-8")
    return outcome


def _build(job: Job, device: Device, progress: Progress) -> dict[str, float | None]:
    """Build and verify the table; its figures."""
    path, options = job.folder / TABLE, job.options
    build_table(
        device,
        path,
        created=job.created,
        clicks_up_to=options.clicks_up_to,
        click_options=ClickOptions(pitch_m=options.pitch_m),
        progress=progress,
    )
    with Table.open(path, device=device, code_fingerprint=job.code_fingerprint) as table:
        return compute_table_figures(table)


def _prepare(job: Job, progress: Progress) -> tuple[Device, dict[str, Any]]:
    """The device that the table is built from, and what a verdict needs of the report of its calibration."""
    unit = job.unit
    text = text_with_values(read_text(unit.device, DeviceError), unit.values, str(unit.device))
    device = Device.parse(text, str(unit.device))
    if unit.measurements is None:
        return device, {}
    progress("calibration", 0.0)
    return _calibrate(job, device, unit.measurements)


def _calibrate(job: Job, device: Device, path: Path) -> tuple[Device, dict[str, Any]]:
    """The calibrated device and the report; an earlier calibration of the same inputs is used again.

    Raises CalibrationError for measurements and parameters that cannot be used.
    """
    folder = job.folder / f"calibration-{job.key[:12]}"
    if not folder.exists():
        options = job.options
        usual = default_names(device) if options.parameters is None else options.parameters
        names, mass_kg = (*usual, *options.also), options.sensor_mass_kg
        fitted = fit_file(device, path, names, options.loss, sensor_mass_kg=mass_kg, created=job.created, bounds={})
        write_new_folder(folder, fitted.files())
    calibrated = Device.read(folder / f"{device.name}.toml")
    report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    return calibrated, {key: report[key] for key in _JUDGED}
