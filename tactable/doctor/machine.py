"""Checks what this machine allows a real-time loop: sleep states, priority, memory, processors. Changes nothing."""

import os
import resource

from engine.loop.realtime import DMA_LATENCY_PATH, DMA_LATENCY_REMEDY, LIMITS_REMEDY, PRIORITY
from tactable.doctor.check import Check
from tactable.doctor.ports import SystemFiles

_LOCKED_BYTES = 1 << 29  # more memory than a run uses, with numpy and a table of ten zones
_FAST = "performance"


def check_machine(files: SystemFiles) -> list[Check]:
    """Checks of everything that can make a run late; none is needed for it to work."""
    return [
        _check_sleep(files),
        _check_limit("priority", resource.RLIMIT_RTPRIO, PRIORITY, "SCHED_FIFO"),
        _check_limit("locked memory", resource.RLIMIT_MEMLOCK, _LOCKED_BYTES, "mlockall"),
        _check_processors(),
        _check_governor(files),
    ]


def _check_sleep(files: SystemFiles) -> Check:
    path = files.root / DMA_LATENCY_PATH.relative_to("/")
    if not path.exists():
        return Check("processor sleep", "this kernel has no cpu_dma_latency")
    if os.access(path, os.W_OK):
        return Check("processor sleep", "a run may keep processors awake: --realtime dma-latency")
    return Check("processor sleep", "a run may not keep processors awake", DMA_LATENCY_REMEDY, needed=False)


def _check_limit(name: str, limit: int, wanted: int, what: str) -> Check:
    _, most = resource.getrlimit(limit)
    if os.geteuid() == 0 or most == resource.RLIM_INFINITY or most >= wanted:
        return Check(name, f"a run may have {what}")
    return Check(name, f"a run may not have {what}: the limit is {most}, {wanted} wanted", LIMITS_REMEDY, needed=False)


def _check_processors() -> Check:
    count = len(os.sched_getaffinity(0))
    if count > 1:
        return Check("processors", f"{count}")
    return Check("processors", "one: everything else runs where the loop does", "use a machine with two", needed=False)


def _check_governor(files: SystemFiles) -> Check:
    slow = files.governors() - {_FAST}
    if not slow:
        return Check("governor", ", ".join(files.governors()) or "the kernel sets none")
    remedy = "run `sudo cpupower frequency-set -g performance`"
    return Check("governor", f"{', '.join(sorted(slow))}: a processor that rested begins slowly", remedy, needed=False)
