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
        """Add the processor time of this process to a step."""
        start_s = time.process_time()
        try:
            yield
        finally:
            self.processor_s[step] += time.process_time() - start_s

    @contextmanager
    def with_workers(self, step: str) -> Iterator[None]:
        """Add the processor time of the processes that end meanwhile to a step: their start and imports included."""
        start_s = _ended_children_s()
        try:
            yield
        finally:
            self.processor_s[step] += _ended_children_s() - start_s


def _ended_children_s() -> float:
    """Processor time of all children of this process that have ended."""
    times = os.times()
    return times.children_user + times.children_system
