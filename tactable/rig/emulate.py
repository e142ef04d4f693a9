"""Emulates the firmware of a device, with faults, behind a pseudo-terminal that any host can open. SIMULATED."""

import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.device import Device
from engine.device.parts import board_bias
from firmware_link.emulator.c_core import CompiledFirmware, open_library
from firmware_link.emulator.device_server import DeviceServer
from firmware_link.emulator.device_state import LONGEST_LEASE_MS, DeviceConfiguration
from firmware_link.emulator.emulator_process import termination_descriptor
from firmware_link.emulator.fault_plan import FaultPlan
from firmware_link.emulator.faulty_device import FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.pty import PseudoTerminal, serve
from firmware_link.host.emulator_registry import Announcement, own_link
from firmware_link.protocol.messages import PM_PER_M

if TYPE_CHECKING:
    from tactable.rig.accelerometer import SensedBoard, SensedSurface


@dataclass(frozen=True)
class Emulated:
    """What an emulator reports when it starts, and whenever the name of its port changes."""

    port: str
    stable_name: str
    number_of_actuators: int
    seed: int


def configuration_of(device: Device | None, boot_id: int = 0) -> DeviceConfiguration:
    """Configuration of the board of a device; without a device, two actuators of 0.52 um full scale."""
    if device is None:
        return DeviceConfiguration(boot_id)
    full_scales_pm = tuple(round(actuator.full_scale_m * PM_PER_M) for actuator in device.actuators)
    return DeviceConfiguration(
        boot_id,
        len(device.actuators),
        LONGEST_LEASE_MS,
        full_scales_pm=full_scales_pm,
        electrode_bias=board_bias(actuator.electrodes for actuator in device.actuators),
    )


def emulate(
    configuration: DeviceConfiguration,
    plan: FaultPlan,
    seed: int,
    on_start: Callable[[Emulated], None],
    core: Path | None = None,
    link: Path | None = None,
    bar: "SensedSurface | None" = None,
) -> dict[str, Any]:
    """Emulate until SIGINT or SIGTERM; returns the counters and the injected faults by kind.

    The firmware is the library `core` that `make host` builds, or without one its Python twin. `link` becomes a
    symbolic link to the port. With `bar` the board has an accelerometer on the simulated bar, which only the Python
    twin can have. Raises LinkError where another file or link is at `link`.
    """
    library = None if core is None else open_library(core)
    own = own_link(os.getpid())
    own.unlink(missing_ok=True)  # of an earlier process with this number
    announcements = [Announcement(own), *([] if link is None else [Announcement(link)])]

    def on_port(port: str) -> None:
        for announcement in announcements:
            announcement.point_to(port)
        on_start(Emulated(port, str(announcements[-1].link), configuration.number_of_actuators, seed))

    def on_gone() -> None:
        for announcement in announcements:
            announcement.close()

    def start(boot_id: int) -> "EmulatedFirmware | CompiledFirmware | SensedBoard":
        booted = replace(configuration, boot_id=boot_id)
        if bar is not None:
            return bar.boot(booted)
        return EmulatedFirmware(booted) if library is None else CompiledFirmware(library, booted, keeps_samples=False)

    try:
        with termination_descriptor() as termination:
            server = DeviceServer(
                FaultyDevice(start, plan, seed), PseudoTerminal, time.monotonic_ns(), on_port, on_gone
            )
            serve(server, [termination])
            server.close()
    finally:
        on_gone()
    cores = [boot.core for boot in server.device.boots]
    counters = [asdict(core.counters) | asdict(core.framing_counters) for core in cores]
    return {"simulated": True, "boots": counters, "faults": server.device.fault_counts()}
