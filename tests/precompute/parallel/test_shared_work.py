"""Shared work: every job once, results in their order, the same with and without a crew."""

import operator
from functools import partial

import numba
import pytest

from precompute.parallel.pool import Crew
from precompute.parallel.shared_work import solve_shared


def doubling() -> partial[int]:
    return partial(operator.mul, 2)


@pytest.mark.parametrize("helpers", [0, 1])
def test_results_come_in_the_order_of_the_jobs(helpers: int) -> None:
    done = list[float]()
    with Crew(helpers) as crew:
        assert solve_shared(crew, doubling, range(7), done.append) == [0, 2, 4, 6, 8, 10, 12]
    assert done == pytest.approx([k / 7 for k in range(1, 8)])


def test_the_threads_of_kernels_are_as_before_even_where_a_job_fails() -> None:
    threads = numba.get_num_threads()

    def begin() -> partial[float]:
        return partial(operator.truediv, 1)

    with Crew(0) as crew, pytest.raises(ZeroDivisionError):
        solve_shared(crew, begin, [1, 0], lambda _: None)
    assert numba.get_num_threads() == threads
