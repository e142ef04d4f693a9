"""The device file of a placement: the description of the device with its actuators at other positions."""

import copy
import math
from collections.abc import Sequence

import tomlkit

from base.points import order_of, sides_of
from engine.device import Device
from precompute.studies.placement_search import with_actuators_at


def placed_text(device: Device, name: str, position_m: Sequence[complex]) -> str:
    """Text of the device called `name` with an actuator at each position, in metres; comments and order are kept.

    The positions are no longer marked as estimates: the study chose them. Where there are more positions than
    actuators, actuators are repeated, as `with_actuators_at` does. A calibration is left out, since its covariance is
    that of the actuators where they were.
    """
    document = tomlkit.parse(device.text)
    rank = sorted(range(len(device.actuators)), key=lambda i: order_of(device.actuators[i].position_m))
    own, count = document["actuator"], len(position_m)
    placed = tomlkit.aot()
    for i, actuator in enumerate(with_actuators_at(device, position_m).actuators):
        table = copy.deepcopy(own[rank[i * len(rank) // count]])
        sides = [f"{1e3 * side_m:.3f} mm" for side_m in sides_of(actuator.position_m) if not math.isnan(side_m)]
        table["name"], table["position"] = actuator.name, sides if len(sides) > 1 else sides[0]
        if "position" in table.get("inferred", []):
            table["inferred"].remove("position")
        placed.append(table)
    document["actuator"], document["name"] = placed, name
    document.pop("calibration", None)
    return tomlkit.dumps(document)
