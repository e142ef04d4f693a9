"""Jobs solved by new processes, which end with the iterator."""

from collections.abc import Iterator, Sequence

from precompute.parallel.pool import Begin, Job, Result, WorkerPool


def solve_in_processes(begin: Begin[Job, Result], chunks: Sequence[Sequence[Job]], workers: int) -> Iterator[Result]:
    """The results of all jobs, in any order, by at most `workers` processes; see `WorkerPool.solve`."""
    with WorkerPool(min(workers, len(chunks))) as pool:
        yield from pool.solve(begin, chunks)
