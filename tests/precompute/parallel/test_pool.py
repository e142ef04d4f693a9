"""Laws of the workers: every job is solved once, failures are told, and no process is left behind."""

import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numba
import pytest
import scipy.linalg  # noqa: F401  # as solvers do: with it BLAS comes to a process
from threadpoolctl import threadpool_info

from base.errors import TactableError
from precompute.parallel.pool import (
    Begin,
    Job,
    Result,
    WorkerError,
    WorkerPool,
    _interrupts_held_back,
    remembered_interrupt,
)

CHUNKS = [[1, 2, 3], [4], [5, 6], [7]]


def squares() -> Callable[[int], tuple[int, int]]:
    return lambda job: (job**2, os.getpid())


def slow_squares() -> Callable[[int], tuple[int, int]]:
    def solve(job: int) -> tuple[int, int]:
        time.sleep(0.01)
        return job**2, os.getpid()

    return solve


inverse: partial[float] = partial(operator.truediv, 1)


def inverses() -> partial[float]:
    return inverse


def blas_threads() -> Callable[[int], int]:
    return lambda _: max(int(each["num_threads"]) for each in threadpool_info() if each["user_api"] == "blas")


def dies() -> Callable[[int], int]:
    os._exit(7)


def none_left() -> bool:
    return not multiprocessing.active_children()


def test_ctrl_c_that_another_thread_hears_is_told_once_processes_are_started() -> None:
    """Python would raise it in the main thread, though that has blocked it: a process would miss what it is to do."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    begins, is_started = threading.Event(), False

    def strike() -> None:
        begins.wait()
        signal.raise_signal(signal.SIGINT)

    other = threading.Thread(target=strike)
    other.start()
    before = signal.set_wakeup_fd(writer)  # written as soon as a thread has heard
    try:
        with pytest.raises(KeyboardInterrupt), _interrupts_held_back():
            begins.set()
            assert os.read(reader, 1) == bytes([signal.SIGINT])
            is_started = sum(range(100)) > 0
    finally:
        signal.set_wakeup_fd(before)
        other.join()
        os.close(reader)
        os.close(writer)
    assert is_started


def test_without_workers_the_caller_solves_all_in_the_order_of_the_jobs() -> None:
    done = list[float]()
    assert dict(WorkerPool(0).solve(squares, CHUNKS, include_self=True)) == {n**2: os.getpid() for n in range(1, 8)}
    assert WorkerPool(0).solve_in_order(inverse, [1, 2, 4, 8], done.append) == [1, 0.5, 0.25, 0.125]
    assert done == pytest.approx([0.25, 0.5, 0.75, 1])
    assert list(solve_in_processes(squares, [], 2)) == []


def test_the_threads_of_kernels_are_as_before_even_where_a_job_fails() -> None:
    threads = numba.get_num_threads()
    with pytest.raises(ZeroDivisionError):
        WorkerPool(0).solve_in_order(inverse, [1, 0], lambda _: None)
    assert numba.get_num_threads() == threads


@pytest.mark.machine(stall_s=None)
def test_workers_solve_every_job_once_with_one_thread_each_and_what_a_solver_raises_is_raised_here() -> None:
    with WorkerPool(2) as pool:
        pool.prepare(squares)
        found = dict(pool.solve(squares, CHUNKS))
        assert set(found) == {job**2 for chunk in CHUNKS for job in chunk} and os.getpid() not in found.values()
        assert all(len({found[job**2] for job in chunk}) == 1 for chunk in CHUNKS), "a chunk is of one process"
        assert list(pool.solve(blas_threads, [[1], [2]])) == [1, 1]
        assert pool.solve_in_order(inverse, [1, 2, 4, 8], lambda _: None) == [1, 0.5, 0.25, 0.125]
        shared = dict(pool.solve(slow_squares, [[n] for n in range(300)], include_self=True))
        assert set(shared) == {n**2 for n in range(300)}
        assert os.getpid() in shared.values() and len(set(shared.values())) > 1, "the caller solves what workers do not"
        with pytest.raises(ZeroDivisionError):
            list(pool.solve(inverses, [[2, 0], [4]]))
    assert none_left()
    assert len({pid for _, pid in solve_in_processes(squares, [[1, 2]], 5)}) == 1, "no more processes than chunks"


@pytest.mark.machine(stall_s=None)
def test_a_process_that_ends_is_told_and_none_is_left_behind() -> None:
    with pytest.raises(WorkerError, match="ended before its work was done") as told:
        list(solve_in_processes(dies, CHUNKS, 2))
    assert isinstance(told.value, TactableError) and none_left()
    with WorkerPool(1) as pool:
        (pid,) = {pid for _, pid in pool.solve(squares, [[1]])}
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(WorkerError):  # where work is asked for next
            list(pool.solve(squares, CHUNKS))
    assert none_left()
    results = solve_in_processes(squares, CHUNKS, 2)
    next(results)
    results.close()  # type: ignore[attr-defined]  # it is a generator
    assert none_left(), "an iterator that is closed"


SCRIPT = """
import time
from precompute.parallel.pool import WorkerPool

def begin():
    return solve

def solve(job):
    time.sleep(0.0 if job == 0 else 600.0)
    return job

if __name__ == "__main__":
    with WorkerPool(2) as pool:
        for result in pool.solve(begin, [[0], [1], [1]]):
            print("solved", result, flush=True)
"""


@pytest.mark.machine(stall_s=None)
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
from precompute.parallel.pool import WorkerPool
def begin():
    def solve(job):
        Path(sys.argv[1]).touch()
        ctypes.PyDLL(None).sleep(30)  # holds the interpreter, as a kernel does
        Path(sys.argv[1]).unlink()
    return solve
if __name__ == "__main__":
    with WorkerPool(1) as pool:
        list(pool.solve(begin, [[1]]))
"""


@pytest.mark.machine(stall_s=None)
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


class Thing:
    """Something that can be weakly referred to."""


@pytest.fixture(autouse=True)
def _default_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_within_a_finalizer_comes_up_at_the_next_check() -> None:
    with remembered_interrupt() as check:
        check()
        thing = Thing()
        reference = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGINT))
        del thing  # the exception of its finalizer is ignored
        assert reference() is None
        with pytest.raises(KeyboardInterrupt):
            check()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_elsewhere_comes_up_at_once() -> None:
    with remembered_interrupt(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_what_an_interrupt_left_half_closed_is_destroyed_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    class HalfClosed:
        def __del__(self) -> None:
            raise AttributeError

    before = sys.unraisablehook
    with remembered_interrupt(), pytest.raises(KeyboardInterrupt):
        half_closed = HalfClosed()
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            del half_closed
    assert sys.unraisablehook is before and capfd.readouterr() == ("", "")


def test_a_handler_of_somebody_else_stays() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with remembered_interrupt() as check:
        signal.raise_signal(signal.SIGINT)
        check()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def solve_in_processes(begin: Begin[Job, Result], chunks: Sequence[Sequence[Job]], workers: int) -> Iterator[Result]:
    """The results of all jobs, in any order, by at most `workers` processes; see `WorkerPool.solve`."""
    with WorkerPool(min(workers, len(chunks))) as pool:
        yield from pool.solve(begin, chunks)
