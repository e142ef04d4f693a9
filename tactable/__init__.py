"""The command `tactable`, and what a program or a notebook imports of it.

    from tactable import Device, Table, build_table, calibrate

What is imported is loaded then: neither the command nor the live side waits for solver and compiler.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.device import Device as Device
    from engine.table import Table as Table
    from precompute.builder.build import build_table as build_table
    from precompute.calibration.calibrate import calibrate as calibrate
    from precompute.calibration.device_text import calibrated_device as calibrated_device
    from precompute.measurements.file import read_measurements as read_measurements
    from tactable.shipped import find_device as find_device

_HOMES = {
    "Device": "engine.device",
    "Table": "engine.table",
    "build_table": "precompute.builder.build",
    "calibrate": "precompute.calibration.calibrate",
    "calibrated_device": "precompute.calibration.device_text",
    "find_device": "tactable.shipped",
    "read_measurements": "precompute.measurements.file",
}
__all__ = ["Device", "Table", "build_table", "calibrate", "calibrated_device", "find_device", "read_measurements"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
