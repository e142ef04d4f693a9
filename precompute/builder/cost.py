"""Cost of a build: processor time of each step, that of worker processes included, and counts of what was solved."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

STEPS = ("responses", "sweep", "clicks")


@dataclass
class BuildCost:
    """processor_s: by step; a step whose result was taken over takes none. clicks: how many were solved now."""

    processor_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STEPS, 0.0))
    clicks: int = 0

    @contextmanager
    def measured(self, step: str) -> Iterator[None]:
        """Add the processor time of this process to a step, and that of the processes that end meanwhile."""
        start_s = _processor_s()
        try:
            yield
        finally:
            self.processor_s[step] += _processor_s() - start_s


def _processor_s() -> float:
    """Processor time of this process and of all its children that have ended, their start and imports included."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system
