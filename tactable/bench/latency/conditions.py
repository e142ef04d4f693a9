"""Conditions of a measurement - engine, rate, background load, real-time steps, machine - and their order.

A shared machine drifts. So every condition is measured in several short segments, in rounds that each begin with
another condition, and each engine is measured next to its floor: all of them meet the same machine.
"""

import os
import platform
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from base.child import Child, Parent
from engine.loop.realtime import Step

TACTABLE, ECHO, WITHOUT_FAST_PATH, ZONES = "tactable", "C echo", "tactable without fast path", "tactable, zones"
SOCKET_BIT_RATE_HZ = 1_000_000_000  # a socket pair is no line: what is written has arrived
PTY_BIT_RATE_HZ = 2_000_000  # that of a fast UART; a terminal ignores it, the renewals count with it
_CPU = Path("/sys/devices/system/cpu")
_MEMORY_BYTES = 1 << 26  # 64 MiB: more than a cache holds, so the copies go to memory


class BackgroundLoad(StrEnum):
    """Kind of load beside the engine under measurement."""

    IDLE = "idle"  # only what the machine does anyway
    STRESS = "stress"  # for each processor one process that computes and one that moves memory
    THREAD = "thread"  # a busy Python thread in the engine's own process: it shows why no other thread may live there


@dataclass(frozen=True)
class Condition:
    """Which engine, how many reports a second, beside which load, and with which real-time steps."""

    engine: str
    rate_hz: int
    load: BackgroundLoad
    steps: tuple[Step, ...]

    @property
    def steps_text(self) -> str:
        """The steps in words, such as "all", "none" or "all but memory"."""
        missing = [step for step in Step if step not in self.steps]
        if not self.steps:
            return "none"
        return f"all but {', '.join(missing)}" if missing else "all"

    @property
    def name(self) -> str:
        """For people, and as a key."""
        return f"{self.engine}, {self.rate_hz}/s, {self.load}, steps {self.steps_text}"


@dataclass(frozen=True)
class Transport:
    """Line of the commands: a socket pair, an emulated firmware behind a pseudo-terminal, or a given port."""

    name: str  # `sockets`, `pty`, or the name of a port
    bit_rate_hz: int = SOCKET_BIT_RATE_HZ

    @property
    def is_sockets(self) -> bool:
        """Whether reports come without a driver in between."""
        return self.name == "sockets"


@dataclass(frozen=True)
class Plan:
    """All conditions of a measurement; `rates_hz` rise."""

    rates_hz: tuple[int, ...]
    loads: tuple[BackgroundLoad, ...]
    steps: tuple[Step, ...]
    has_echo: bool  # the C echo engine is measured too, as a floor
    ablates: bool  # also without each step, without all of them, without the fast path, and with drives of zones
    has_zones: bool  # the table has rows of the sweep, which zones play

    @property
    def middle_hz(self) -> int:
        """The rate at which steps are left out."""
        return self.rates_hz[len(self.rates_hz) // 2]

    def conditions(self, load: BackgroundLoad) -> tuple[Condition, ...]:
        """Every condition beside a load, each engine next to its floor."""
        if load is BackgroundLoad.THREAD:
            return (Condition(TACTABLE, self.middle_hz, load, self.steps),)
        engines = (TACTABLE, ECHO) if self.has_echo else (TACTABLE,)
        found = [Condition(engine, rate_hz, load, self.steps) for rate_hz in self.rates_hz for engine in engines]
        ablated = BackgroundLoad.STRESS if BackgroundLoad.STRESS in self.loads else BackgroundLoad.IDLE
        if self.ablates and load is ablated:
            one_less = [tuple(s for s in self.steps if s is not out) for out in self.steps if len(self.steps) > 1]
            found += [Condition(TACTABLE, self.middle_hz, load, steps) for steps in ((), *one_less)]
            others = (WITHOUT_FAST_PATH, ZONES) if self.has_zones else (WITHOUT_FAST_PATH,)
            found += [Condition(engine, self.middle_hz, load, self.steps) for engine in others]
        return tuple(found)

    def rounds(self, count: int) -> Iterator[tuple[int, BackgroundLoad, Sequence[Condition]]]:
        """Round, load and its conditions; each round begins with another condition, so that none is always first."""
        for number in range(count):
            for load in self.loads:
                conditions = self.conditions(load)
                first = number % len(conditions)
                yield number, load, (*conditions[first:], *conditions[:first])

    def floor_of(self, condition: Condition) -> Condition | None:
        """The C echo engine beside the same load, at the same rate and with the same steps; None without one."""
        if condition.engine != TACTABLE:
            return None
        floor = Condition(ECHO, condition.rate_hz, condition.load, condition.steps)
        return floor if floor in self.conditions(condition.load) else None


@contextmanager
def background_load(load: BackgroundLoad) -> Iterator[None]:
    """Run the processes of a load for the length of a `with` block; the busy thread belongs to the engine's process."""
    kinds = ("compute", "memory") * (os.cpu_count() or 1) if load is BackgroundLoad.STRESS else ()
    children = [Child(__name__, {"kind": kind}, name=f"the background load {kind}") for kind in kinds]
    try:
        yield
    finally:
        for child in children:
            child.kill()


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Work without end: the parent kills this process, or the system does when the parent is gone."""
    parent.end_with_it()
    block, target = bytes(_MEMORY_BYTES), bytearray(_MEMORY_BYTES)
    while True:
        if arguments["kind"] == "memory":
            target[:] = block
        else:
            sum(range(1_000_000))


def environment_json() -> dict[str, Any]:
    """Processor, kernel, governor, versions and clock; None for what is unknown."""
    processor, kernel = _read(Path("/proc/cpuinfo")), _read(Path("/proc/version")) or ""
    model = re.search(r"^model name\s*: *(.*)", processor or "", re.MULTILINE)
    clock = time.get_clock_info("monotonic")
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "system": platform.platform(),
        "processor": model[1] if model else platform.processor() or None,
        "processors": os.cpu_count(),
        "allowed_processors": sorted(os.sched_getaffinity(0)),
        "virtual_machine": None if processor is None else " hypervisor" in processor,
        "preemption": next((word for word in kernel.split() if word.startswith("PREEMPT")), None),
        "governor": _read(_CPU / "cpu0/cpufreq/scaling_governor"),
        "idle_driver": _read(_CPU / "cpuidle/current_driver"),
        "isolated_processors": _read(_CPU / "isolated"),
        "clock_source": _read(Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")),
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("tactable", "numpy", "pyserial", "cobs")},
        "clock": {"name": "CLOCK_MONOTONIC", "resolution_ns": 1e9 * clock.resolution, "reading_ns": reading_ns()},
    }


def reading_ns() -> float:
    """Cost of one reading of the clock of all stamps, the median of 2000."""
    return float(np.median(np.diff([time.monotonic_ns() for _ in range(2001)])))


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or None
    except OSError:
        return None
