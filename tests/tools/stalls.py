"""Evidence that the machine stood still: the test's process came late, or one that it started was stopped or waited."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

PERIOD_S = 0.005
PROCESSES_PERIOD_S = 0.02
DESCENDANTS_PERIOD_S = 0.1
"""To look for new processes means to read of all that the machine runs."""
STALL_S = 0.05
"""Longer than a processor that is shared fairly lets a process wait, and half of the shortest lease."""
MOST_TOLD = 5
MOST_THREADS = 12
"""An emulator computes in other threads than its first; to look at all of a browser's would cost too much."""
_NS_PER_S = 1e9
_stopped_by_tests = set[int]()


class Evidence:
    """What stood still for longer than a limit, and for how long at most."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self.longest_s = dict[str, float]()

    def add(self, what: str, duration_s: float) -> None:
        """Keep what lasted longer than the limit."""
        if duration_s > max(self._limit_s, self.longest_s.get(what, 0.0)):
            self.longest_s[what] = duration_s

    def __bool__(self) -> bool:
        return bool(self.longest_s)

    def __str__(self) -> str:
        longest = sorted(self.longest_s.items(), key=lambda found: found[1], reverse=True)[:MOST_TOLD]
        return "; ".join(f"{what} {duration_s:.2f} s" for what, duration_s in longest)


class _Process:
    """The stops and delays of a process between one look and the next."""

    def __init__(self, pid: int) -> None:
        self._folder, self._pid = f"/proc/{pid}", pid
        self._delays_s = self._read_delays_s()
        self._stopped_since_s: float | None = None
        self._name = f"process {pid} ({_read(f'{self._folder}/comm').decode().strip()})"

    def _read_delays_s(self) -> dict[str, float]:
        """Of its threads; where there are very many, of the first."""
        threads = os.listdir(f"{self._folder}/task")  # noqa: PTH208 - a Path for each takes twice as long
        threads = threads if len(threads) <= MOST_THREADS else [str(self._pid)]
        return {each: int(_read(f"{self._folder}/task/{each}/schedstat").split()[1]) / _NS_PER_S for each in threads}

    def look(self, evidence: Evidence, now_s: float) -> None:
        """A wait for a processor is added as a whole when it ends, so a step of the sum is one wait."""
        delays_s = self._read_delays_s()
        for thread, delay_s in delays_s.items():
            evidence.add(f"{self._name} waited for a processor for", delay_s - self._delays_s.get(thread, delay_s))
        self._delays_s = delays_s
        is_stopped = state_and_parent(self._folder)[0] in "Tt" and self._pid not in _stopped_by_tests
        if not is_stopped:
            self._stopped_since_s = None
        elif self._stopped_since_s is None:
            self._stopped_since_s = now_s
        else:
            evidence.add(f"{self._name} was stopped for", now_s - self._stopped_since_s)


def _read(path: str) -> bytes:
    """A small file of /proc, in 8 us where a Path takes 20 us: one for each thread is read every 20 ms."""
    file = os.open(path, os.O_RDONLY)
    try:
        return os.read(file, 4096)
    finally:
        os.close(file)


def state_and_parent(folder: str) -> tuple[str, int]:
    """State and parent of a process from its folder in /proc."""
    state, parent = _read(f"{folder}/stat").rpartition(b")")[2].split()[:2]
    return state.decode(), int(parent)


def descendants(pid: int) -> set[int]:
    """The processes that this one started, and those that they started."""
    children = dict[int, list[int]]()
    for name in filter(str.isdigit, os.listdir("/proc")):  # noqa: PTH208
        with contextlib.suppress(OSError):
            children.setdefault(state_and_parent(f"/proc/{name}")[1], []).append(int(name))
    found, left = set[int](), [pid]
    while left:
        new = children.get(left.pop(), [])
        found.update(new)
        left += new
    return found


class _Watch:
    """Looks at this process every 5 ms, at its descendants every 20 ms, and for new ones every 100 ms."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._before_s, self._computed_s = time.monotonic(), time.process_time()
        self._looked_s = self._sought_s = self._before_s
        self._processes = dict[int, _Process]()
        self._seek_processes()

    def look(self) -> None:
        """Compare the time that went by with the time that this process computed."""
        now_s, computed_s = time.monotonic(), time.process_time()
        gap_s = now_s - self._before_s - (computed_s - self._computed_s)
        self._evidence.add("the test's own process stood still for", gap_s)
        self._before_s, self._computed_s = now_s, computed_s
        if now_s - self._looked_s > PROCESSES_PERIOD_S:
            self._looked_s = now_s
            for process in self._processes.values():
                with contextlib.suppress(OSError, IndexError):  # it ends while it is looked at
                    process.look(self._evidence, now_s)
        if now_s - self._sought_s > DESCENDANTS_PERIOD_S:
            self._sought_s = now_s
            self._seek_processes()

    def _seek_processes(self) -> None:
        found = descendants(os.getpid())
        for pid in self._processes.keys() - found:
            del self._processes[pid]
        for pid in found - self._processes.keys():
            with contextlib.suppress(OSError, IndexError):
                self._processes[pid] = _Process(pid)


@contextmanager
def watched(limit_s: float = STALL_S) -> Iterator[Evidence]:
    evidence, has_ended = Evidence(limit_s), threading.Lock()
    has_ended.acquire()
    watch = _Watch(evidence)

    def run() -> None:
        while not has_ended.acquire(timeout=PERIOD_S):
            watch.look()
        watch.look()

    thread = threading.Thread(target=run, name="watch for stalls")
    thread.start()
    try:
        yield evidence
    finally:
        has_ended.release()
        thread.join()


def hear_of_stops(event: str, args: tuple[Any, ...]) -> None:
    """A test that stops a process, or lets it go on, means it."""
    if event == "os.kill" and args[1] == signal.SIGSTOP:
        _stopped_by_tests.add(args[0])
    elif event == "os.kill" and args[1] == signal.SIGCONT:
        _stopped_by_tests.discard(args[0])
