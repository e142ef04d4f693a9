"""Run the units of a fleet: in this process, in processes of this machine, or on a Dask scheduler.

Each unit is calibrated, built and verified in its folder. Its outcome is written last and marks it as complete, so an
interrupted fleet continues where it was; units that an earlier run completed are kept.
"""

import json
import logging
import math
import statistics
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from base.errors import TactableError
from base.files import remove_partials, replace_file, write_new_folder
from engine.device import Device, DeviceError
from engine.device.named_files import text_with_values
from engine.device.toml_table import read_text
from engine.device.values import device_values
from engine.steady.steady_drive import compute_levels
from engine.steady.steady_solver import SteadySolver
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.table.netcdf_file import file_checksum
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.table_build import Progress, build_table, no_progress
from precompute.calibration.fitted import REPORT, fit_file
from precompute.clicks import ClickOptions
from precompute.fleet.units import FleetError, FleetOptions, Job, Outcome, Unit, make_job
from precompute.measurements.parameters import default_names
from precompute.studies.placement_search import finger_pairs

Pool = Callable[[Sequence[Job], Progress], Iterator[Outcome]]
"""Runs jobs and yields their outcomes in any order; reports progress within a job where it can."""
_PATIENCE_S = 30  # patience with a scheduler and its first worker; Dask's own default for connecting
TABLE = "table.nc"
DEVICE = "device.toml"
OUTCOME = "outcome.json"
_JUDGED = ("parameters", "adequacy", "readings", "median_misfit", "noise", "wrong_readings")

# Two threads that enter numba's parallel kernels at once abort the process.
_one_at_a_time = threading.Lock()


def run_fleet(
    units: Sequence[Unit],
    options: FleetOptions,
    out: Path,
    pool: Pool,
    *,
    created: str,
    progress: Progress = no_progress,
) -> list[Outcome]:
    """Outcomes in the order of the units; each unit has a folder in `out`. The tables note `created`.

    `pool` runs the jobs of the units that are not complete.
    """
    outcomes: dict[str, Outcome] = {}
    jobs = list[Job]()
    for unit in units:
        try:
            job = make_job(unit, options, out, created)
        except OSError as error:
            outcomes[unit.name] = Outcome(unit.name, "", error=describe_error(error))
            continue
        if kept := kept_outcome(job):
            outcomes[unit.name] = kept
        else:
            jobs.append(job)
    before, total = len(outcomes), len(units)

    def on_progress(step: str, fraction: float) -> None:
        progress(step, (before + fraction * len(jobs)) / total)

    if jobs:
        for outcome in pool(jobs, on_progress):
            outcomes[outcome.name] = outcome
            progress(outcome.name, len(outcomes) / total)
    return [outcomes[unit.name] for unit in units]


def run_here(jobs: Sequence[Job], progress: Progress) -> Iterator[Outcome]:
    """Run the jobs one after another in this process, with numba on all cores."""
    for done, job in enumerate(jobs):

        def on_progress(step: str, fraction: float, name: str = job.unit.name, done: int = done) -> None:
            progress(f"{name}: {step}", (done + fraction) / len(jobs))

        yield run_job(job, on_progress)


def run_on_processes(workers: int) -> Pool:
    """Run the jobs in processes of this machine with one thread each; a killed process is replaced."""

    def run(jobs: Sequence[Job], _progress: Progress) -> Iterator[Outcome]:
        distributed = _distributed()
        cluster = distributed.LocalCluster(
            n_workers=min(workers, len(jobs)),
            threads_per_worker=1,
            memory_limit=None,  # a build limits its own memory
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
        with cluster, distributed.Client(cluster) as client:
            yield from _run_through(client, jobs)

    return run


def run_on_scheduler(address: str) -> Pool:
    """Run the jobs on a scheduler such as tcp://host:8786; its workers need the same tactable and the same folders.

    Raises FleetError if the scheduler cannot be reached or has no worker.
    """

    def run(jobs: Sequence[Job], _progress: Progress) -> Iterator[Outcome]:
        distributed = _distributed()
        try:
            client = distributed.Client(address, timeout=_PATIENCE_S)
        except (OSError, ValueError) as error:
            raise FleetError(f"{address}: no scheduler answers there: {error}") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=_PATIENCE_S)
            except TimeoutError as error:
                raise FleetError(f"{address}: the scheduler has no worker; start one: dask worker {address}") from error
            yield from _run_through(client, jobs)

    return run


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise FleetError("processes and schedulers need dask.distributed: pip install 'tactable[fleet]'") from error
    return distributed


def _run_through(client: Any, jobs: Sequence[Job]) -> Iterator[Outcome]:
    """Outcomes as they come; a unit whose workers were killed repeatedly has failed."""
    job_of = {client.submit(run_in_worker, job, key=f"tactable-{job.unit.name}-{job.key[:16]}"): job for job in jobs}
    try:
        for future in _distributed().as_completed(job_of):
            job = job_of[future]
            try:
                yield future.result()
            except Exception as error:  # the worker failed, not the unit: it was killed or cannot import tactable
                yield Outcome(job.unit.name, job.key, error=describe_error(error))
    finally:
        client.cancel(list(job_of))


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
        is_whole = outcome.key == job.key and outcome.table_crc32 == file_checksum(job.folder / TABLE)
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
    figures = _build(job, device, progress)
    outcome = Outcome(
        name=job.unit.name,
        key=job.key,
        fingerprint=device.fingerprint,
        table_crc32=file_checksum(job.folder / TABLE),
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
        fitted = fit_file(device, path, names, sensor_mass_kg=mass_kg, created=job.created, bounds={})
        write_new_folder(folder, fitted.files())
    calibrated = Device.read(folder / f"{device.name}.toml")
    report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    return calibrated, {key: report[key] for key in _JUDGED}


def compute_table_figures(table: Table) -> dict[str, float | None]:
    """Figures by name with units; None where a bar has no such figure."""
    solver = SteadySolver(table.device, table.modes)
    contrast_db = list(_contrasts(table, solver))
    loudest = [solver.solve([zone.middle_m], [True], math.inf) for zone in table.device.zones]
    return {
        "worst_expected_contrast_db": min(contrast_db, default=None),
        "median_expected_contrast_db": statistics.median(contrast_db) if contrast_db else None,
        "least_full_level_db": min(drive.weakest_felt_db for drive in loudest),
        "rows_out_of_reach": sum(not row.achieved for rows in table.best_rows.values() for row in rows),
        "clicks": len(table.clicks),
        "click_pitch_mm": 1e3 * table.places.pitch_m if table.clicks else None,
        "weakest_click_db": min(table.clicks.felt_low_db.tolist(), default=None),
    }


def _contrasts(table: Table, solver: SteadySolver) -> Iterator[float]:
    """Felt over quiet power in dB, each averaged over sampled fingers, of every felt and quiet finger in mid-zone.

    Of the drives that a run solves at 20 dB.
    """
    device = table.device
    for felt, quiet in finger_pairs(device):
        position_m = device.zones[felt].middle_m, device.zones[quiet].middle_m
        drive = solver.solve(position_m, [True, False], DEFAULT_LEVEL_DB)
        amplitude = np.asarray(drive.complex_amplitudes)
        _, *sampled_db = compute_levels(device, table.modes, position_m, drive.frequencies_hz, amplitude)
        of_felt, of_quiet = (10 ** (np.array(sampled_db) / 10)).mean(axis=0)
        yield float(10 * np.log10(of_felt / of_quiet))
