"""Laws of the workers: every job is solved once, failures are told, and no process is left behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401  # as solvers do: with it BLAS comes to a process
from threadpoolctl import threadpool_info

from precompute.parallel.pool import Crew, WorkerError, solve_in_processes

CHUNKS = [[1, 2, 3], [4], [5, 6], [7]]


def squares() -> Callable[[int], tuple[int, int]]:
    return lambda job: (job**2, os.getpid())


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
    with pytest.raises(WorkerError, match="exit status 7"):
        list(solve_in_processes(dies, CHUNKS, 2))
    assert none_left()


def test_whoever_stops_asking_leaves_no_process() -> None:
    results = solve_in_processes(squares, CHUNKS, 2)
    next(results)
    results.close()  # type: ignore[attr-defined]  # it is a generator
    assert none_left()


def test_whoever_lends_a_hand_solves_what_the_others_do_not() -> None:
    assert dict(Crew(0).solve(squares, CHUNKS, lends_a_hand=True)) == {n**2: os.getpid() for n in range(1, 8)}
    with Crew(1) as crew:
        crew.prepare(squares)
        found = dict(crew.solve(squares, [[n] for n in range(300)], lends_a_hand=True))
        again = dict(crew.solve(squares, CHUNKS))
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
    for result in solve_in_processes(begin, [[0, 1], [0, 1]], 2):
        print("solved", result, flush=True)
"""


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


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
