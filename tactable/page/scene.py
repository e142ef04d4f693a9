"""The values of a device that the page draws, for JSON."""

from typing import Any

from base.plain import to_plain
from engine.device import Device


def device_json(device: Device) -> dict[str, Any]:
    """Name, length, zones, actuators, greatest amplitude, number of estimated values, and the threshold curve."""
    return {
        "name": device.name,
        "description": device.description,
        "length_m": device.bar.length_m,
        "zones": to_plain(device.zones),
        "actuators": [
            {"name": each.name, "position_m": each.position_m, "band_hz": list(each.band_hz)}
            for each in device.actuators
        ],
        "most": device.limits.amplitude,
        "estimates": len(device.estimated_values),
        "threshold": device.threshold.title,
    }
