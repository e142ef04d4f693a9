"""Laws of the workers: every job is solved once, failures are told, and no process is left behind."""

import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numba
import pytest
import scipy.linalg  # noqa: F401  # as solvers do: with it BLAS comes to a process
from threadpoolctl import threadpool_info

from base.errors import TactableError
from precompute.parallel.pool import WorkerError, WorkerPool, solve_in_processes

pytestmark = pytest.mark.machine

CHUNKS = [[1, 2, 3], [4], [5, 6], [7]]


def squares() -> Callable[[int], tuple[int, int]]:
    return lambda job: (job**2, os.getpid())


def slow_squares() -> Callable[[int], tuple[int, int]]:
    def solve(job: int) -> tuple[int, int]:
        time.sleep(0.01)
        return job**2, os.getpid()

    return solve


def odd_ones_fail() -> Callable[[int], int]:
    def solve(job: int) -> int:
        if job % 2:
            raise ValueError(f"{job} is odd")
        return job

    return solve


def dies() -> Callable[[int], int]:
    os._exit(7)


def none_left() -> bool:
    return not multiprocessing.active_children()


def test_every_job_is_solved_once_and_a_chunk_by_one_process() -> None:
    found = dict(solve_in_processes(squares, CHUNKS, 2))
    assert set(found) == {job**2 for chunk in CHUNKS for job in chunk}
    assert all(len({found[job**2] for job in chunk}) == 1 for chunk in CHUNKS)
    assert os.getpid() not in found.values() and none_left()


def test_there_are_no_more_processes_than_chunks() -> None:
    assert len({pid for _, pid in solve_in_processes(squares, [[1, 2]], 5)}) == 1
    assert list(solve_in_processes(squares, [], 2)) == []


def test_what_a_solver_raises_is_raised_here() -> None:
    with pytest.raises(ValueError, match="3 is odd"):
        list(solve_in_processes(odd_ones_fail, [[2, 3], [4]], 2))
    assert none_left()


def test_a_process_that_ends_by_itself_is_told() -> None:
    with pytest.raises(WorkerError, match="ended before its work was done"):
        list(solve_in_processes(dies, CHUNKS, 2))
    assert issubclass(WorkerError, TactableError) and none_left()


def test_a_killed_process_is_told_where_work_is_asked_for_next() -> None:
    with WorkerPool(1) as pool:
        (pid,) = {pid for _, pid in pool.solve(squares, [[1]])}
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(WorkerError):
            list(pool.solve(squares, CHUNKS))
    assert none_left()


def test_an_iterator_that_is_closed_leaves_no_process() -> None:
    results = solve_in_processes(squares, CHUNKS, 2)
    next(results)
    results.close()  # type: ignore[attr-defined]  # it is a generator
    assert none_left()


def test_the_caller_solves_what_the_workers_do_not() -> None:
    assert dict(WorkerPool(0).solve(squares, CHUNKS, include_self=True)) == {n**2: os.getpid() for n in range(1, 8)}
    with WorkerPool(1) as pool:
        pool.prepare(squares)
        found = dict(pool.solve(slow_squares, [[n] for n in range(300)], include_self=True))
        again = dict(pool.solve(squares, CHUNKS))
    assert set(found) == {n**2 for n in range(300)}
    assert len(set(found.values())) == 2 and os.getpid() in found.values()
    assert set(again.values()) == set(found.values()) - {os.getpid()} and none_left()


def blas_threads() -> Callable[[int], int]:
    return lambda _: max(int(each["num_threads"]) for each in threadpool_info() if each["user_api"] == "blas")


def test_blas_has_one_thread_in_each_process() -> None:
    assert list(solve_in_processes(blas_threads, [[1], [2]], 2)) == [1, 1]


SCRIPT = """
import time
from precompute.parallel.pool import solve_in_processes

def begin():
    return solve

def solve(job):
    time.sleep(0.0 if job == 0 else 600.0)
    return job

if __name__ == "__main__":
    for result in solve_in_processes(begin, [[0], [1], [1]], 2):
        print("solved", result, flush=True)
"""


def doubling() -> partial[int]:
    return partial(operator.mul, 2)


@pytest.mark.parametrize("workers", [0, 1])
def test_results_come_in_the_order_of_the_jobs(workers: int) -> None:
    done = list[float]()
    with WorkerPool(workers) as pool:
        assert pool.solve_in_order(doubling, range(7), done.append) == [0, 2, 4, 6, 8, 10, 12]
    assert done == pytest.approx([k / 7 for k in range(1, 8)])


def test_the_threads_of_kernels_are_as_before_even_where_a_job_fails() -> None:
    threads = numba.get_num_threads()

    def begin() -> partial[float]:
        return partial(operator.truediv, 1)

    with pytest.raises(ZeroDivisionError):
        WorkerPool(0).solve_in_order(begin, [1, 0], lambda _: None)
    assert numba.get_num_threads() == threads


def test_ctrl_c_in_a_terminal_ends_all_of_them_with_one_trace(tmp_path: Path) -> None:
    script = tmp_path / "sleepers.py"
    script.write_text(SCRIPT)
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, script], stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "solved 0\n"
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate()
    assert errors.count("Traceback") == 1 and errors.rstrip().endswith("KeyboardInterrupt")
    while _group_lives(process.pid):  # ends as soon as the last one is reaped
        time.sleep(0.01)


KERNEL = """
import ctypes, os, sys
from pathlib import Path
from precompute.parallel.pool import solve_in_processes
def begin():
    def solve(job):
        Path(sys.argv[1]).touch()
        ctypes.PyDLL(None).sleep(30)  # holds the interpreter, as a kernel does
        Path(sys.argv[1]).unlink()
    return solve
if __name__ == "__main__":
    list(solve_in_processes(begin, [[1]], 1))
"""


def test_a_worker_in_a_kernel_does_not_outlive_a_killed_process(tmp_path: Path) -> None:
    script, computing = tmp_path / "kernel.py", tmp_path / "computing"
    script.write_text(KERNEL)
    process = subprocess.Popen([sys.executable, script, computing], start_new_session=True)
    while not computing.exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    while _group_lives(process.pid):
        time.sleep(0.01)
    assert computing.exists()  # the kernel was not waited for


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
