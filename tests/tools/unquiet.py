"""Proof that tests fail for faults of the code: they are run again and again on a machine that is made unquiet.

    python -m tests.tools.unquiet --loops 2 --stops --random-order --times 5 -- -m machine -n 0

Busy loops compete for the processors, any process of the tests is stopped for 0.05 to 2 s at random instants, and the
tests run in random order. The table says which tests were broken, or not shown, how often. The end is 1 if a test was
broken. All of it is drawn from `--seed`, which is printed; the instants at which a stop meets a test are the machine's.
"""

import argparse
import contextlib
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from tests.tools.stalls import descendants

STOP_S = (0.05, 2.0)
BETWEEN_STOPS_S = (0.2, 3.0)
_TOLD = re.compile(r"^(FAILED|ERROR|NOT SHOWN) (.+?)(?: - .*)?$", re.MULTILINE)


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


def run_once(words: Sequence[str], source: random.Random, has_stops: bool) -> tuple[str, int]:
    """What pytest printed, and its status."""
    with (
        tempfile.TemporaryDirectory() as state,
        subprocess.Popen(
            [sys.executable, "-m", "pytest", *words],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_STATE_HOME": state, "COLUMNS": "1000"},
        ) as tests,
    ):
        has_ended = threading.Event()
        stopper = threading.Thread(target=stop_at_random, args=(tests.pid, source, has_ended))
        if has_stops:
            stopper.start()
        try:
            printed, _ = tests.communicate()
        finally:
            has_ended.set()
            if has_stops:
                stopper.join()
    return printed, tests.returncode


def parse(words: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.unquiet", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--loops", type=int, default=os.cpu_count(), help="busy loops; default: one per processor")
    parser.add_argument("--stops", action="store_true", help="stop processes of the tests at random")
    parser.add_argument("--random-order", action="store_true", help="files, and the tests of each, in random order")
    parser.add_argument("--times", type=int, default=1, help="number of runs")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    parser.add_argument("words", nargs="*", help="what pytest is given, after --")
    return parser.parse_args(words)


def main() -> int:
    """Run, and print the table; 1 if a test was broken or pytest ended by itself."""
    chosen = parse(sys.argv[1:])
    source = random.Random(chosen.seed)
    sys.stdout.write(f"seed {chosen.seed}\n")
    counts, is_broken = Counter[tuple[str, str]](), False
    with busy_loops(chosen.loops):
        for number in range(chosen.times):
            order = ["--order-seed", str(source.randrange(10**6))] if chosen.random_order else []
            printed, status = run_once([*chosen.words, *order], source, chosen.stops)
            sys.stdout.write(printed)
            is_broken |= status != 0
            counts.update((test, verdict) for verdict, test in _TOLD.findall(printed))
            sys.stdout.write(f"run {number + 1} of {chosen.times} ended with status {status}\n")
    for (test, verdict), count in sorted(counts.items()):
        name = "not shown" if verdict == "NOT SHOWN" else "broken"
        sys.stdout.write(f"{name} {count} of {chosen.times}: {test}\n")
    return int(is_broken)


if __name__ == "__main__":
    sys.exit(main())
