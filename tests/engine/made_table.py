"""A table file made by hand: entries and clicks as they are given, responses of one number."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from engine.device import Device
from engine.table import ClickEntry, Entry
from engine.table.columns import write_clicks, write_entries
from engine.table.file import TableWriter, Variable

PLAIN = {"created": "2024-01-01", "code_fingerprint": "c0de", "code_version": "1", "objective": "contrast"}


def write_table(
    path: Path,
    device: Device,
    entries: Sequence[Entry],
    clicks: Sequence[ClickEntry] = (),
    *,
    response: float = 1.0,
    others: Mapping[str, float] | None = None,
    **attributes: str,
) -> Path:
    """Write it; `response` is every acceleration of it, `attributes` replace those in PLAIN, `others` are groups."""
    everywhere = np.full((2, len(device.actuators), len(device.zones), 2, 2), response)
    with TableWriter(path) as writer:
        own = {"device_name": device.name, "device_description": device.text, "device_fingerprint": device.fingerprint}
        writer.describe({**PLAIN, **own, **attributes})
        for name, dimensions, values in (
            ("frequency", ("frequency",), np.array([100.0, 200.0])),
            ("position", ("zone", "point"), np.array([[zone.start_m, zone.stop_m] for zone in device.zones])),
            ("acceleration", ("frequency", "actuator", "zone", "point", "part"), everywhere),
        ):
            writer.write("responses", Variable(name, dimensions, "1", "made by hand"), values)
        writer.write("responses", Variable.names("actuator"), [actuator.name for actuator in device.actuators])
        write_entries(writer, entries, device)
        for group, number in (others or {}).items():
            writer.write(group, Variable("number", (), "1", "made by hand"), np.array(number))
        if clicks:
            write_clicks(writer, clicks, device)
    return path
