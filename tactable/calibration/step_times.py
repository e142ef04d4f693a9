"""Stopwatch of a piece of work whose steps are reported as they begin."""

import time
from collections.abc import Callable

Progress = Callable[[str, float], None]


class StepTimes:
    """Seconds by step, from its creation on; a step ends when another one is reported."""

    def __init__(self, show: Progress, step: str, clock_s: Callable[[], float] = time.perf_counter) -> None:
        self._show, self._step, self._clock_s = show, step, clock_s
        self._start_s = self._since_s = clock_s()
        self._seconds: dict[str, float] = {}

    def tell_step(self, step: str, fraction: float) -> None:
        """Report the present step and the fraction done, and pass both on."""
        self._show(step, fraction)
        if step != self._step:
            self._end_step()
            self._step = step

    def read(self) -> dict[str, float]:
        """Seconds of every step so far, the present one included, in the order of their beginning."""
        self._end_step()
        return dict(self._seconds)

    @property
    def total_s(self) -> float:
        """Seconds since its creation."""
        return self._clock_s() - self._start_s

    def _end_step(self) -> None:
        now_s = self._clock_s()
        self._seconds[self._step] = self._seconds.get(self._step, 0.0) + now_s - self._since_s
        self._since_s = now_s


def times_text(seconds: dict[str, float]) -> str:
    """The times in words, such as "fit 0.7 s, sweep 0.9 s"; steps of no time are left out."""
    return ", ".join(f"{step} {value:.2g} s" for step, value in seconds.items() if value >= 0.01)
