"""Jobs to results in their order, by this process and a crew, one thread each."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import numba

from precompute.parallel.pool import Crew

Job = TypeVar("Job")
Result = TypeVar("Result")


def solve_shared(
    crew: Crew, begin: Callable[[], Callable[[Job], Result]], jobs: Sequence[Job], told: Callable[[float], None]
) -> list[Result]:
    """One result a job; `begin` gives a process its solver, by pickling. `told` the fraction done."""
    numbered, results = [[each] for each in enumerate(jobs)], dict[int, Result]()
    with _one_thread():
        for number, result in crew.solve(partial(_begin, begin), numbered, lends_a_hand=True):
            results[number] = result
            told(len(results) / len(jobs))
    return [results[number] for number in range(len(jobs))]


def _begin(begin: Callable[[], Callable[[Job], Result]]) -> Callable[[tuple[int, Job]], tuple[int, Result]]:
    numba.set_num_threads(1)
    solve = begin()
    return lambda numbered: (numbered[0], solve(numbered[1]))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Threads that wait for one another at every small step lose most of a busy machine."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)
