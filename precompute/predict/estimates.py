"""Which estimated values of a device matter most: by how much a tenth of each changes the responses under fingers.

Every level and every contrast follows from these responses. A value that is not in the model of the surface, its
actuators and the finger (a zone, a step of the sweep) changes none of them.
"""

import re
import tomllib
from typing import Any

import numpy as np

from base.arrays import Complex
from engine.device import Device, DeviceError
from engine.device.parts import Plate
from precompute.model.assembly import assemble, free_surface
from precompute.model.plant import Plant
from precompute.model.response import solve_response

SHARE = 0.1  # share by which a value is changed
_LINES = 24  # over the band of the sweep
_NAME = re.compile(r"(bar|plate|finger|actuator)(?:\[(\d+)\])?\.(\w+)")
_QUANTITY = re.compile(r"\s*([-+.\deE]+)\s*(\D.*)")
_BESIDE_MODEL = ("band", "spread")


def weigh_estimates(device: Device) -> list[tuple[str, float]]:
    """Estimated values and the relative change of responses by a tenth of each, the weightiest first."""
    before = _responses(device, assemble(device))
    found = [(name, _change(device, name, before)) for name in device.estimated_values]
    return sorted(((name, change) for name, change in found if change), key=lambda each: -each[1])


def _change(device: Device, name: str, before: Complex) -> float:
    match, document = _NAME.fullmatch(name), tomllib.loads(device.text)
    if match is None or match[3] in _BESIDE_MODEL:
        return 0.0
    table: Any = document.get(match[1], {})
    value = (table[int(match[2]) - 1] if match[2] else table).get(match[3])
    quantity = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if quantity is None:
        return 0.0
    try:
        changed = device.with_values({name: f"{(1 + SHARE) * float(quantity[1])!r} {quantity[2]}"})
    except DeviceError:  # beyond what the device allows, as a place beside its surface
        return 0.0
    is_as_long = isinstance(device.surface, Plate) and name not in ("plate.length", "plate.width")
    # The modes of a plate take most of the time, and serve whatever its values become.
    plant = free_surface(device).plant(changed) if is_as_long else assemble(changed)
    return float(np.linalg.norm(_responses(changed, plant) - before) / np.linalg.norm(before))


def _responses(device: Device, plant: Plant) -> Complex:
    """Acceleration (line, actuator, finger) under a finger in the middle of every zone, for a unit of each command."""
    hz = np.linspace(device.sweep.frequency_hz[0], device.sweep.frequency_hz[-1], _LINES)
    at_m = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    return solve_response(plant.with_fingers(at_m, device.finger), hz).acceleration(np.array(at_m))
