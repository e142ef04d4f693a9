"""Where the units of a fleet are run: in this process, by processes of this machine, or by a Dask scheduler."""

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from precompute.fleet.error import FleetError
from precompute.fleet.units import Job, Outcome
from precompute.fleet.work import Progress, describe_error, run_in_worker, run_job

Pool = Callable[[Sequence[Job], Progress], Iterator[Outcome]]
"""Jobs to outcomes in any order; tells the fraction done where it knows more than which are."""
_PATIENCE_S = 30


def run_here(jobs: Sequence[Job], progress: Progress) -> Iterator[Outcome]:
    """One after another in this process, numba on all cores."""
    for done, job in enumerate(jobs):

        def told(step: str, fraction: float, name: str = job.unit.name, done: int = done) -> None:
            progress(f"{name}: {step}", (done + fraction) / len(jobs))

        yield run_job(job, told)


def run_on_processes(workers: int) -> Pool:
    """By so many processes of this machine, one unit and one thread each; one that is killed is started anew."""

    def run(jobs: Sequence[Job], _progress: Progress) -> Iterator[Outcome]:
        distributed = _distributed()
        cluster = distributed.LocalCluster(
            n_workers=min(workers, len(jobs)),
            threads_per_worker=1,
            memory_limit=None,  # a build bounds its own
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
        with cluster, distributed.Client(cluster) as client:
            yield from _run_through(client, jobs)

    return run


def run_on_scheduler(address: str) -> Pool:
    """By the workers of a scheduler, such as tcp://host:8786; they have the same tactable and see the same folders.

    Raises FleetError if it cannot be reached or has no worker.
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
    """Outcomes as they come. A unit whose workers were killed again and again has failed."""
    job_of = {client.submit(run_in_worker, job, key=f"tactable-{job.unit.name}-{job.key[:16]}"): job for job in jobs}
    try:
        for future in _distributed().as_completed(job_of):
            job = job_of[future]
            try:
                yield future.result()
            except Exception as error:  # of the worker, not of the unit: killed, or unable to import us
                yield Outcome(job.unit.name, job.key, error=describe_error(error))
    finally:
        client.cancel(list(job_of))
