"""Jobs to results by several processes, each with a solver of its own; none is left behind."""

import contextlib
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Job = TypeVar("Job")
Result = TypeVar("Result")

_SOLVED, _IDLE, _FAILED = "solved", "idle", "failed"
_PATIENCE_S = 5.0


class WorkerError(RuntimeError):
    """A process ended before its work was done."""


def solve_in_processes(
    begin: Callable[[], Callable[[Job], Result]], chunks: Sequence[Sequence[Job]], workers: int
) -> Iterator[Result]:
    """The results of all jobs, in any order; the jobs of a chunk are solved one after another by one process.

    `begin` gives a process its solver; it goes there by pickling, as jobs and results do. BLAS has one thread in each.
    What a solver raises is raised here; WorkerError where a process was killed. When the iterator is closed, or left
    by an exception such as Ctrl-C, the processes have ended.
    """
    waiting = deque(chunks)
    with _running(begin, min(workers, len(chunks))) as processes:
        for worker in processes:
            worker.line.send(waiting.popleft())
        busy = list(processes)
        while busy:
            ready = wait([worker.line for worker in busy])
            for worker in [worker for worker in busy if worker.line in ready]:
                kind, value = _received(worker)
                if kind == _FAILED:
                    raise value
                if kind == _SOLVED:
                    yield value
                elif waiting:
                    worker.line.send(waiting.popleft())
                else:
                    busy.remove(worker)


@dataclass(frozen=True)
class _Worker:
    """A process and our end of the line to it."""

    process: SpawnProcess
    line: Connection


def _received(worker: _Worker) -> tuple[str, Any]:
    try:
        message: tuple[str, Any] = worker.line.recv()
    except (EOFError, ConnectionError):
        worker.process.join(_PATIENCE_S)
        code = worker.process.exitcode
        told = f"a process ended with exit status {code} before its work was done; try fewer workers"
        raise WorkerError(told) from None
    return message


@contextlib.contextmanager
def _running(begin: Callable[[], Callable[[Any], Any]], count: int) -> Iterator[list[_Worker]]:
    workers = list[_Worker]()
    try:
        for _ in range(count):
            workers.append(_start(begin))
        yield workers
    finally:
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.process.join()
            worker.line.close()


def _start(begin: Callable[[], Callable[[Any], Any]]) -> _Worker:
    # A new interpreter, not a fork: the libraries in this one may hold locks and threads.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, begin), daemon=True)
    with _interrupts_held_back():
        process.start()
    theirs.close()
    return _Worker(process, ours)


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Ctrl-C goes to every process of a terminal; those started here never see it, for we end them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(line: Connection, begin: Callable[[], Callable[[Any], Any]]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it cannot be held back
    with threadpool_limits(1, "blas"), contextlib.suppress(EOFError, ConnectionError):  # the other side is gone
        try:
            solve = begin()
            while True:
                for job in line.recv():
                    line.send((_SOLVED, solve(job)))
                line.send((_IDLE, None))
        except (EOFError, ConnectionError):
            return
        except Exception as error:  # whatever it is, it is raised where the results are asked for
            line.send((_FAILED, error))
