"""Tells how long the machine stood still: what a stall cut off is shown again by tests in real time."""

import functools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec

P = ParamSpec("P")

PERIOD_S = 0.005
LIMIT_S = 0.1
"""Shorter than the 120 ms after which the engine lifts silent fingers, by more than a loop's period."""
ATTEMPTS = 5


class Stalls:
    """The longest time for which a thread that wants to run every 5 ms did not run."""

    longest_s = 0.0

    @property
    def are_long(self) -> bool:
        """Whether a run in real time was disturbed."""
        return self.longest_s > LIMIT_S


@contextmanager
def watched() -> Iterator[Stalls]:
    """Stalls during the block."""
    stalls, has_ended = Stalls(), threading.Event()

    def watch() -> None:
        before_s = time.monotonic()
        while not has_ended.wait(PERIOD_S):
            now_s = time.monotonic()
            stalls.longest_s = max(stalls.longest_s, now_s - before_s)
            before_s = now_s

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield stalls
    finally:
        has_ended.set()
        thread.join()


def again_after_a_stall(law: Callable[P, None]) -> Callable[P, None]:
    """A test that is run again where it failed and the machine stood still meanwhile."""

    @functools.wraps(law)
    def shown(*args: P.args, **kwargs: P.kwargs) -> None:
        for attempt in range(ATTEMPTS):
            with watched() as stalls:
                try:
                    law(*args, **kwargs)
                except AssertionError:
                    if attempt == ATTEMPTS - 1 or not stalls.are_long:
                        raise
                else:
                    return

    return shown
