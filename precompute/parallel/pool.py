"""Worker processes: jobs to results by `concurrent.futures`, with one solver in each process and none left behind.

A worker is a new interpreter, not a fork, since the libraries of this one may hold locks and threads. It computes with
one thread of BLAS and of numba: there is one process a core. Ctrl-C of a terminal reaches this process alone, which
then ends its workers. A worker whose parent was killed is killed by the system: a thread that waits for the parent
would itself wait for a kernel that computes, up to 13 s. Python ignores an exception that comes up within a finalizer:
`remembered_interrupt` keeps a Ctrl-C that would be lost so.
"""

import contextlib
import ctypes
import itertools
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any, TypeVar

import numba
from threadpoolctl import threadpool_limits

from base.errors import TactableError

Job = TypeVar("Job")
Result = TypeVar("Result")
Begin = Callable[[], Callable[[Job], Result]]  # gives a process its solver, by pickling as jobs and results
_PR_SET_PDEATHSIG = 1


class WorkerError(TactableError, RuntimeError):
    """A worker process ended before its work was done."""


def available_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0))


class WorkerPool:
    """`count` processes, which `prepare` starts before there is work: their imports take a second.

    Use it in a `with` block, at the end of which the processes have ended. Without workers the caller solves all.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._numbers = itertools.count()

    def __enter__(self) -> "WorkerPool":
        if self.count:
            spawn = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(self.count, spawn, initializer=_end_with_parent)
        return self

    def __exit__(self, *unused: object) -> None:
        if self.count:
            # shutdown() alone would wait for the running jobs.
            for process in list((self._executor._processes or {}).values()):
                process.terminate()
            self._executor.shutdown(cancel_futures=True)

    def prepare(self, begin: Callable[[], object]) -> None:
        """Let every worker import what `begin` is made of, and call it, while this process does something else."""
        for _ in range(self.count):
            self._submit(_prepare, begin)

    def solve(
        self, begin: Begin[Job, Result], chunks: Sequence[Sequence[Job]], *, include_self: bool = False
    ) -> Iterator[Result]:
        """The results of all jobs, in any order; the jobs of a chunk are solved one after another by one process.

        With `include_self` this process solves chunks too. What a solver raises is raised here. Raises WorkerError
        where a worker was killed.
        """
        number, waiting, own = next(self._numbers), deque(chunks), deque[Job]()
        solve_here = begin() if include_self else None
        with one_thread() if include_self and self.count else contextlib.nullcontext():
            running = set[Future[list[Result]]]()
            while waiting or running or own:
                while waiting and len(running) < self.count:
                    running.add(self._submit(_solve_chunk, number, begin, waiting.popleft()))
                if solve_here and waiting and not own:
                    own.extend(waiting.popleft())
                done, running = wait(running, 0 if own else None, FIRST_COMPLETED)
                for future in done:
                    yield from self._result(future)
                if solve_here and own:
                    yield solve_here(own.popleft())

    def solve_in_order(
        self, solve: Callable[[Job], Result], jobs: Sequence[Job], on_progress: Callable[[float], None]
    ) -> list[Result]:
        """One result for each job, in their order, solved by this process and the workers, with one thread each.

        `solve` goes to the workers by pickling; `on_progress` is called with the fraction done.
        """
        found = dict[int, Result]()
        with one_thread():
            numbered = [[each] for each in enumerate(jobs)]
            for number, result in self.solve(partial(_numbering, solve), numbered, include_self=True):
                found[number] = result
                on_progress(len(found) / len(jobs))
        return [found[number] for number in range(len(jobs))]

    def _submit(self, function: Callable[..., Result], *arguments: object) -> Future[Result]:
        try:
            with _interrupts_held_back():  # a process may be started here
                return self._executor.submit(function, *arguments)
        except BrokenProcessPool:
            raise _killed() from None

    @staticmethod
    def _result(future: Future[Result]) -> Result:
        try:
            return future.result()
        except BrokenProcessPool:
            raise _killed() from None


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Numba computes with one thread: processes share the cores better, since half of a search is Python."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


def _numbering(solve: Callable[[Job], Result]) -> Callable[[tuple[int, Job]], tuple[int, Result]]:
    """The solver of numbered jobs, which numbers its results."""
    return lambda numbered: (numbered[0], solve(numbered[1]))


def _killed() -> WorkerError:
    return WorkerError("a worker process was ended before its work was done; memory may be short: try fewer workers")


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Processes started here inherit that SIGINT is blocked, and so never see the Ctrl-C of a terminal.

    Python tells the main thread of a Ctrl-C that any other thread has heard. It is told here once the processes are
    started: one that was not given what it is to do would print a traceback.
    """
    before, heard = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}), list[tuple[int, FrameType | None]]()
    handler = signal.getsignal(signal.SIGINT)
    is_told = callable(handler) and threading.current_thread() is threading.main_thread()
    if is_told:
        signal.signal(signal.SIGINT, lambda number, frame: heard.append((number, frame)))
    try:
        yield
    finally:
        if is_told:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if heard and callable(handler):
            handler(*heard[0])


def _end_with_parent() -> None:
    """Have the system kill this worker when the thread that started it ends, however it ended."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = multiprocessing.parent_process()
    assert parent is not None
    if os.getppid() != parent.pid:  # it was gone before that
        os._exit(1)


def _prepare(begin: Callable[[], object]) -> None:
    begin()


_solver: tuple[int, Callable[[Any], Any]] | None = None  # the number of this worker's task, and its solver


def _solve_chunk(number: int, begin: Begin[Any, Any], chunk: Sequence[Any]) -> list[Any]:
    """The results of one chunk in a worker, by the solver that is kept for the other chunks of the same task."""
    global _solver
    if _solver is None or _solver[0] != number:
        threadpool_limits(1, "blas")  # of the libraries that came with `begin`: nothing was imported before
        numba.set_num_threads(1)
        _solver = number, begin()
    return [_solver[1](job) for job in chunk]


@contextmanager
def remembered_interrupt() -> Iterator[Callable[[], None]]:
    """Raise KeyboardInterrupt at Ctrl-C, and again from the function that is given wherever that was ignored.

    Only where Ctrl-C raises it anyway: in the main thread, under Python's own handler.
    """
    asked, hook = False, sys.unraisablehook

    def handle(*_: object) -> None:
        nonlocal asked
        asked, sys.unraisablehook = True, _ignore
        raise KeyboardInterrupt

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    is_ours = threading.current_thread() is threading.main_thread()
    if not is_ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield check
        return
    signal.signal(signal.SIGINT, handle)
    try:
        yield check
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _ignore(_: object) -> None:
    """Do not print an exception of a finalizer. After Ctrl-C the finalizers of half-closed objects fail."""
