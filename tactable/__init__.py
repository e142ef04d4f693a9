"""The command `tactable`, and all that a program or a notebook imports of it.

    import tactable
    from tactable import Device, Table, build_table, calibrate

What is imported is loaded then: neither the command nor the live side waits for solver and compiler.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from base.errors import TactableError as TactableError
    from engine.device import Device as Device
    from engine.device.quantity import quantity_text as quantity_text
    from engine.table.table_diff import compare_tables as compare_tables
    from firmware_link.host.link import Link as Link
    from firmware_link.host.link_values import LinkConfiguration as LinkConfiguration
    from firmware_link.host.link_values import LinkState as LinkState
    from firmware_link.host.serial_port import SerialPort as SerialPort
    from firmware_link.host.session import Session as Session
    from firmware_link.protocol.drive_words import ChannelDrive as ChannelDrive
    from firmware_link.protocol.drive_words import encode_drive as encode_drive
    from firmware_link.protocol.messages import Fault as Fault
    from precompute.builder.table_build import build_table as build_table
    from precompute.calibration.calibrate import calibrate as calibrate
    from precompute.calibration.fitted import calibrated_device as calibrated_device
    from precompute.measurements.measurement_file import read_measurements as read_measurements
    from precompute.sampling.plants import sample_devices as sample_devices
    from tactable.control.client import connect as connect
    from tactable.control.client import connect_async as connect_async
    from tactable.research.played import Table as Table
    from tactable.research.untabulated import modes as modes
    from tactable.research.untabulated import placement as placement
    from tactable.research.untabulated import response as response
    from tactable.research.untabulated import solve_click as solve_click
    from tactable.research.untabulated import solve_drive as solve_drive
    from tactable.shipped import find_device as find_device

_HOMES = {
    "ChannelDrive": "firmware_link.protocol.drive_words",
    "Device": "engine.device",
    "Fault": "firmware_link.protocol.messages",
    "Link": "firmware_link.host.link",
    "LinkConfiguration": "firmware_link.host.link_values",
    "LinkState": "firmware_link.host.link_values",
    "SerialPort": "firmware_link.host.serial_port",
    "Session": "firmware_link.host.session",
    "Table": "tactable.research.played",
    "TactableError": "base.errors",
    "build_table": "precompute.builder.table_build",
    "calibrate": "precompute.calibration.calibrate",
    "calibrated_device": "precompute.calibration.fitted",
    "compare_tables": "engine.table.table_diff",
    "connect": "tactable.control.client",
    "connect_async": "tactable.control.client",
    "encode_drive": "firmware_link.protocol.drive_words",
    "find_device": "tactable.shipped",
    "modes": "tactable.research.untabulated",
    "placement": "tactable.research.untabulated",
    "quantity_text": "engine.device.quantity",
    "read_measurements": "precompute.measurements.measurement_file",
    "response": "tactable.research.untabulated",
    "sample_devices": "precompute.sampling.plants",
    "solve_click": "tactable.research.untabulated",
    "solve_drive": "tactable.research.untabulated",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("tactable")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__, "__version__"]
