"""Proof that tests fail for faults of the code: they are run again and again on a machine that is made unquiet.

    python -m tests.tools.unquiet --times 5 -- -m machine -n 0

Busy loops compete for the processors, any process of the tests is stopped for 0.05 to 2 s at random instants, and the
tests run in random order. The table says which tests were broken, or not shown, how often. The end is 1 if a test was
broken. All of it is drawn from `--seed`, which is printed; the instants at which a stop meets a test are the machine's.
It is a plugin of the pytest that it starts, too, so that it hears of each verdict.
"""

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.tools.stalls import descendants

STOP_S = (0.05, 2.0)
BETWEEN_STOPS_S = (0.2, 3.0)
_VERDICTS = "TACTABLE_VERDICTS"
"""The environment's name of the file that verdicts are written to, a line for each test that did not hold."""
_NOTHING_TO_RUN = 5


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Write what a test is found to be, where an unquiet run asks for it."""
    verdict = "broken" if report.failed else "not shown" if getattr(report, "not_shown", "") else ""
    if verdict and (path := os.environ.get(_VERDICTS)):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(f"{verdict}: {report.nodeid}\n")


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Processes that compete for the processors."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def stop_at_random(pid: int, source: random.Random, has_ended: threading.Event) -> None:
    """Stop a process of the tests, let it go on, and choose the next."""
    while not has_ended.wait(source.uniform(*BETWEEN_STOPS_S)):
        chosen, duration_s = source.choice([pid, *sorted(descendants(pid))]), source.uniform(*STOP_S)
        with contextlib.suppress(ProcessLookupError):
            os.kill(chosen, signal.SIGSTOP)
            try:
                has_ended.wait(duration_s)
            finally:
                os.kill(chosen, signal.SIGCONT)


def run_once(words: Sequence[str], source: random.Random) -> tuple[list[str], int]:
    """A line for each test that did not hold, and the status of pytest."""
    with tempfile.TemporaryDirectory() as state:
        told = Path(state) / "verdicts"
        told.touch()
        status = _run(words, source, {"XDG_STATE_HOME": state, _VERDICTS: str(told)})
        return told.read_text(encoding="utf-8").splitlines(), status


def _run(words: Sequence[str], source: random.Random, environment: dict[str, str]) -> int:
    command = [sys.executable, "-m", "pytest", "-p", "tests.tools.unquiet", *words]
    with subprocess.Popen(command, env={**os.environ, **environment}) as tests:
        has_ended = threading.Event()
        stopper = threading.Thread(target=stop_at_random, args=(tests.pid, source, has_ended))
        stopper.start()
        try:
            tests.wait()
        finally:
            has_ended.set()
            stopper.join()
    return tests.returncode


def main() -> int:
    """Run, and print the table; 1 if a test was broken or pytest ended by itself."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.unquiet", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--times", type=int, default=1, help="number of runs")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    parser.add_argument("words", nargs="*", help="what pytest is given, after --")
    chosen = parser.parse_args()
    source = random.Random(chosen.seed)
    sys.stdout.write(f"seed {chosen.seed}\n")
    counts, is_broken = Counter[str](), False
    with busy_loops(os.cpu_count() or 1):
        for number in range(chosen.times):
            told, status = run_once([*chosen.words, "--order-seed", str(source.randrange(10**6))], source)
            is_broken |= status not in (0, _NOTHING_TO_RUN)
            counts.update(set(told))
            sys.stdout.write(f"run {number + 1} of {chosen.times} ended with status {status}\n")
            sys.stdout.flush()
    for line, count in sorted(counts.items()):
        sys.stdout.write(f"{count} of {chosen.times} {line}\n")
    return int(is_broken)


if __name__ == "__main__":
    sys.exit(main())
