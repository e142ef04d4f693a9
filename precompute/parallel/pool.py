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
    with Crew(min(workers, len(chunks))) as crew:
        yield from crew.solve(begin, chunks)


class Crew:
    """Processes that may be started before there is work: what they need takes them a second to import.

    Use it in a `with` block; at its end the processes have ended.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._workers = list[_Worker]()

    def __enter__(self) -> "Crew":
        try:
            for _ in range(self.count):
                self._workers.append(_start())
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *unused: object) -> None:
        self._end()

    def prepare(self, begin: Callable[[], Callable[[Any], Any]]) -> None:
        """Let every process import what `begin` is made of, and call it, while this one does something else."""
        for worker in self._workers:
            worker.line.send(begin)

    def solve(
        self,
        begin: Callable[[], Callable[[Job], Result]],
        chunks: Sequence[Sequence[Job]],
        *,
        lends_a_hand: bool = False,
    ) -> Iterator[Result]:
        """As `solve_in_processes`; once at a time. One that `lends_a_hand` solves chunks in this process too."""
        waiting, busy = deque(chunks), list[_Worker]()
        self.prepare(begin)
        for worker in self._workers[: len(waiting)]:
            worker.line.send(waiting.popleft())
            busy.append(worker)
        solve, own = begin() if lends_a_hand else None, deque[Job]()
        while busy or own or (solve and waiting):
            if solve and waiting and not own:
                own.extend(waiting.popleft())
            ready = wait([worker.line for worker in busy], 0 if own else None)
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
            if solve and own:
                yield solve(own.popleft())

    def _end(self) -> None:
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join()
            worker.line.close()
        self._workers.clear()


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


def _start() -> _Worker:
    # A new interpreter, not a fork: the libraries in this one may hold locks and threads.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs,), daemon=True)
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


def _work(line: Connection) -> None:
    """Take what begins a solver, or a chunk for the solver of the last one, until the other side is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it cannot be held back
    solve: Callable[[Any], Any] | None = None
    with contextlib.suppress(EOFError, ConnectionError):  # the other side is gone
        try:
            while True:
                message = line.recv()
                if callable(message):
                    threadpool_limits(1, "blas")  # of what came with the message: nothing was imported before
                    solve = message()
                    continue
                assert solve is not None
                for job in message:
                    line.send((_SOLVED, solve(job)))
                line.send((_IDLE, None))
        except (EOFError, ConnectionError):
            return
        except Exception as error:  # whatever it is, it is raised where the results are asked for
            line.send((_FAILED, error))
