"""One unit to its folder: calibrated, built, verified; its outcome is written last, so that it is complete or not."""

import json
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numba
from threadpoolctl import threadpool_limits

from engine.device import Device, DeviceError
from engine.device.toml_table import read_text
from engine.device.values import device_values
from engine.files import remove_partials, replace_file
from engine.table import Table, TableError
from precompute.builder.build import build_table, code_fingerprint
from precompute.calibration.device_text import text_with_values
from precompute.fleet.calibrated import calibrate_unit
from precompute.fleet.error import FleetError
from precompute.fleet.figures import compute_figures
from precompute.fleet.transfer import judge_table
from precompute.fleet.units import Job, Outcome

TABLE = "table.nc"
DEVICE = "device.toml"
OUTCOME = "outcome.json"
Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done."""
_PIECE_BYTES = 1 << 24

# A process in which two threads enter numba's parallel kernels at once is ended by them.
_one_at_a_time = threading.Lock()


def no_progress(step: str, fraction: float) -> None:
    """Tell nobody."""


def run_in_worker(job: Job) -> Outcome:
    """As `run_job`, on one thread, and one unit of a process at a time."""
    with _one_at_a_time:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        try:
            done = kept_outcome(job)  # by a worker that was killed before it could tell
            return run_job(job) if done is None else replace(done, is_kept=False)
        finally:
            numba.set_num_threads(threads)


def run_job(job: Job, progress: Progress = no_progress) -> Outcome:
    """Calibrate, build and verify a unit; whatever goes wrong is in the outcome."""
    start_s = time.perf_counter()
    try:
        outcome = _run(job, progress)
    except Exception as error:  # whatever befalls a unit, the others go on
        outcome = Outcome(job.unit.name, job.key, error=describe_error(error))
    return replace(outcome, seconds=time.perf_counter() - start_s)


def describe_error(error: Exception) -> str:
    """One line; those that are not for users with their type."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    is_ours = isinstance(error, ValueError | OSError | TableError)
    text = " ".join(str(error).split())
    return text if is_ours and text else f"{type(error).__name__}: {text}"


def kept_outcome(job: Job) -> Outcome | None:
    """The outcome of an earlier run, if nothing that decides it has changed and its table is as it was then."""
    try:
        values = json.loads((job.folder / OUTCOME).read_text(encoding="utf-8"))
        outcome = Outcome(**{**values, "doubts": tuple(values["doubts"]), "is_kept": True})
        is_whole = outcome.key == job.key and (
            outcome.table_crc32 is None or outcome.table_crc32 == _checksum(job.folder / TABLE)
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
    device, doubts = _prepare(job, progress)
    with replace_file(job.folder / DEVICE) as partial:
        partial.write_text(device.text, encoding="utf-8")
    table_crc32 = None
    if job.unit.judged is None:
        figures = _build(job, device, progress)
        table_crc32 = _checksum(job.folder / TABLE)
    else:
        with Table.open(job.unit.judged) as table, threadpool_limits(1, "blas"):
            figures = judge_table(table, device)
    outcome = Outcome(
        name=job.unit.name,
        key=job.key,
        fingerprint=device.fingerprint,
        table_crc32=table_crc32,
        values=device_values(device),
        figures=figures,
        doubts=doubts,
    )
    with replace_file(job.folder / OUTCOME) as partial:
        partial.write_text(outcome.as_json(), encoding="utf-8")
    return outcome


def _build(job: Job, device: Device, progress: Progress) -> dict[str, float | None]:
    """The figures of the device's table, built and verified."""
    path, recipe = job.folder / TABLE, job.recipe
    build_table(
        device,
        path,
        created=job.created,
        objective=recipe.objective,
        clicks_up_to=recipe.clicks_up_to,
        progress=progress,
    )
    with Table.open(path, device=device, code_fingerprint=job.code_fingerprint) as table:
        return compute_figures(table)


def _prepare(job: Job, progress: Progress) -> tuple[Device, tuple[str, ...]]:
    """The device that the table is built of, and why its calibration should not be used unseen."""
    unit = job.unit
    text = text_with_values(read_text(unit.device, DeviceError), unit.values, str(unit.device))
    device = Device.parse(text, str(unit.device))
    if unit.measurements is None:
        return device, ()
    progress("calibration", 0.0)
    return calibrate_unit(job, device, unit.measurements)


def _checksum(path: Path) -> int:
    checksum = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            checksum = zlib.crc32(piece, checksum)
    return checksum
