"""The machine that a measurement ran on, as far as it decides the figures, and the cost of reading the clock."""

import os
import platform
import re
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

_CPU = Path("/sys/devices/system/cpu")


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
