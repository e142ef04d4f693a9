"""Real-time settings of the machine for a loop: each step is optional, reported, and undone at the end."""

import ctypes
import gc
import os
import sys
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

DMA_LATENCY_PATH = Path("/dev/cpu_dma_latency")
PRIORITY = 70  # above the usual SCHED_FIFO threads, below threads of interrupts that have been raised
SWITCH_INTERVAL_S = 1e-4  # longest time that another thread keeps the interpreter; Python's default is 5 ms
GROUP = "realtime"
DMA_LATENCY_RULE = f'KERNEL=="cpu_dma_latency", GROUP="{GROUP}", MODE="0660"'
"""udev rule by which members of the group may keep processors awake."""
_LIMITS_FILE = "/etc/security/limits.d/tactable.conf"
_RULE_FILE = "/etc/udev/rules.d/70-tactable-latency.rules"
_JOIN = f"`sudo groupadd -f {GROUP} && sudo usermod -aG {GROUP} $USER`, log in again"
LIMITS_REMEDY = f"put `@{GROUP} - rtprio 80` and `@{GROUP} - memlock unlimited` into {_LIMITS_FILE}, run {_JOIN}"
DMA_LATENCY_REMEDY = f"put `{DMA_LATENCY_RULE}` into {_RULE_FILE}, run `sudo udevadm control --reload && sudo udevadm \
trigger --name-match=cpu_dma_latency` and {_JOIN}"
_MCL_CURRENT, _MCL_FUTURE = 1, 2


class Step(StrEnum):
    """One setting."""

    DMA_LATENCY = "dma-latency"  # keep processors out of deep sleep: a wake-up takes 14 us instead of 78 on our machine
    PRIORITY = "priority"  # Run as SCHED_FIFO, before all ordinary threads. Dangerous for a loop that never waits.
    MEMORY = "memory"  # lock every page in memory
    AFFINITY = "affinity"  # stay on one processor, whose caches stay warm
    SWITCH_INTERVAL = "switch-interval"  # make other Python threads of this process give way soon
    COLLECTOR = "collector"  # collect garbage once, freeze what lives, and collect no more: it takes 16 ms with numpy


ALL_STEPS = tuple(Step)


@dataclass(frozen=True)
class Outcome:
    """The result of one step; `remedy` is "" where the setting is in force."""

    step: Step
    finding: str
    remedy: str = ""

    @property
    def in_force(self) -> bool:
        """Whether the setting is in force."""
        return not self.remedy


class System:
    """The system calls that need a privilege; each raises OSError where it is refused."""

    def hold_dma_latency(self) -> int:
        """Keep processors out of deep sleep while the returned descriptor is open."""
        descriptor = os.open(DMA_LATENCY_PATH, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.write(descriptor, bytes(4))  # 0 us as an int32
        except OSError:
            os.close(descriptor)
            raise
        return descriptor

    def scheduler(self) -> tuple[int, int]:
        """Scheduling policy and priority of this thread."""
        return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    def set_scheduler(self, policy: int, priority: int) -> None:
        """Change both; child processes keep the usual ones."""
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))

    def processors(self) -> set[int]:
        """The processors that this thread may run on."""
        return set(os.sched_getaffinity(0))

    def set_processors(self, processors: Collection[int]) -> None:
        """Run on these processors only."""
        os.sched_setaffinity(0, processors)

    def lock_memory(self) -> None:
        """Lock all present and future pages in memory."""
        self._call("mlockall", _MCL_CURRENT | _MCL_FUTURE)

    def unlock_memory(self) -> None:
        """Undo `lock_memory`."""
        self._call("munlockall")

    def _call(self, name: str, *arguments: int) -> None:
        function = getattr(ctypes.CDLL(None, use_errno=True), name)
        if function(*arguments) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))


@contextmanager
def real_time(
    steps: Collection[Step] = ALL_STEPS, *, processor: int | None = None, system: System | None = None
) -> Iterator[tuple[Outcome, ...]]:
    """Apply these steps to the calling thread and its process, yield their outcomes, and undo them at the end.

    A refused step is an outcome, not an error. `processor` is for the affinity, by default the last one that this
    process may use, because interrupts mostly go to the first.
    """
    asked = system or System()
    with ExitStack() as stack:
        # Memory before priority: to lock it takes long, and nothing else is to wait for that.
        order = [step for step in (Step.COLLECTOR, Step.MEMORY, *ALL_STEPS) if step in steps]
        done = {step: _take(step, asked, processor, stack) for step in dict.fromkeys(order)}
        yield tuple(done[step] for step in ALL_STEPS if step in done)


def _take(step: Step, system: System, processor: int | None, stack: ExitStack) -> Outcome:
    try:
        match step:
            case Step.DMA_LATENCY:
                stack.callback(os.close, system.hold_dma_latency())
                return Outcome(step, "processors stay awake")
            case Step.PRIORITY:
                before = system.scheduler()
                system.set_scheduler(os.SCHED_FIFO, PRIORITY)
                stack.callback(system.set_scheduler, *before)
                return Outcome(step, f"SCHED_FIFO {PRIORITY}")
            case Step.MEMORY:
                system.lock_memory()
                stack.callback(system.unlock_memory)
                return Outcome(step, "locked")
            case Step.AFFINITY:
                return _take_processor(system, processor, stack)
            case Step.SWITCH_INTERVAL:
                stack.callback(sys.setswitchinterval, sys.getswitchinterval())
                sys.setswitchinterval(SWITCH_INTERVAL_S)
                return Outcome(step, f"{1e6 * SWITCH_INTERVAL_S:g} us")
            case Step.COLLECTOR:
                _still_collector(stack)
                return Outcome(step, "collected, frozen and off")
    except (OSError, AttributeError) as error:  # refused, or not a call of this system
        return Outcome(step, f"refused: {error}", _REMEDIES.get(step, ""))


def _take_processor(system: System, processor: int | None, stack: ExitStack) -> Outcome:
    allowed = system.processors()
    if len(allowed) < 2:
        return Outcome(Step.AFFINITY, "there is one processor: everything shares it", "use a machine with two or more")
    chosen = max(allowed) if processor is None else processor
    system.set_processors({chosen})
    stack.callback(system.set_processors, allowed)
    return Outcome(Step.AFFINITY, f"processor {chosen}")


def _still_collector(stack: ExitStack) -> None:
    # `gc.unfreeze` thaws everything: what the caller had frozen before would be collected again and again.
    if not gc.get_freeze_count():
        stack.callback(gc.unfreeze)
    gc.collect()
    gc.freeze()
    if gc.isenabled():
        gc.disable()
        stack.callback(gc.enable)


_REMEDIES = {
    Step.DMA_LATENCY: DMA_LATENCY_REMEDY,
    Step.PRIORITY: LIMITS_REMEDY,
    Step.MEMORY: LIMITS_REMEDY,
    Step.AFFINITY: "name a processor that this process may use",
}


def parse_steps(text: str) -> tuple[Step, ...]:
    """The steps of a text: `all`, `none`, or names such as `dma-latency,priority`; `all,-priority` leaves one out.

    Raises ValueError with the unknown word and the known ones.
    """
    chosen: dict[Step, None] = {}
    for word in filter(None, (part.strip() for part in text.split(","))):
        if word in ("all", "none"):
            chosen = dict.fromkeys(ALL_STEPS if word == "all" else ())
            continue
        name = word.removeprefix("-")
        if name not in ALL_STEPS:
            raise ValueError(f"real-time step {word!r} is unknown: write all, none, or some of {', '.join(ALL_STEPS)}")
        if word.startswith("-"):
            chosen.pop(Step(name), None)
        else:
            chosen[Step(name)] = None
    return tuple(step for step in ALL_STEPS if step in chosen)
