"""Run the units of a fleet: in this process, in processes of this machine, or on a Dask scheduler.

Units that an earlier run completed are kept. A unit is complete once its outcome is written, which happens last, so an
interrupted fleet continues where it was.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from precompute.builder.table_build import Progress, no_progress
from precompute.fleet.units import FleetError, FleetOptions, Job, Outcome, Unit, make_job
from precompute.fleet.work import describe_error, kept_outcome, run_in_worker, run_job

Pool = Callable[[Sequence[Job], Progress], Iterator[Outcome]]
"""Runs jobs and yields their outcomes in any order; reports progress within a job where it can."""
_PATIENCE_S = 30  # patience with a scheduler and its first worker; Dask's own default for connecting


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
