"""The machine that a measurement ran on, as far as it decides the figures, and the cost of reading the clock."""

import os
import platform
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

_CPU = Path("/sys/devices/system/cpu")


def environment_json() -> dict[str, Any]:
    """Processor, kernel, governor, versions and clock; None for what is unknown."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "system": platform.platform(),
        "processor": _processor(),
        "processors": os.cpu_count(),
        "allowed_processors": sorted(os.sched_getaffinity(0)),
        "virtual_machine": _is_virtual(),
        "preemption": _preemption(),
        "governor": _read(_CPU / "cpu0/cpufreq/scaling_governor"),
        "idle_driver": _read(_CPU / "cpuidle/current_driver"),
        "isolated_processors": _read(_CPU / "isolated"),
        "clock_source": _read(Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")),
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("tactable", "numpy", "pyserial", "cobs")},
        "clock": clock_json(),
    }


def clock_json() -> dict[str, Any]:
    """The clock of all stamps: its resolution, and the cost of one reading."""
    readings = np.array([time.monotonic_ns() for _ in range(2001)])
    resolution_ns = time.get_clock_info("monotonic").resolution * 1e9
    return {
        "name": "CLOCK_MONOTONIC",
        "resolution_ns": resolution_ns,
        "reading_ns": float(np.median(np.diff(readings))),
    }


def _processor() -> str | None:
    for line in (_read(Path("/proc/cpuinfo")) or "").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or None


def _is_virtual() -> bool | None:
    text = _read(Path("/proc/cpuinfo"))
    return None if text is None else " hypervisor" in text


def _preemption() -> str | None:
    """Such as PREEMPT_DYNAMIC, from the kernel's own line."""
    words = (_read(Path("/proc/version")) or "").split()
    return next((word for word in words if word.startswith("PREEMPT")), None)


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or None
    except OSError:
        return None
