"""A table file made by hand: clicks and rows as they are given, responses and receptances of one number."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from engine.device import Device
from engine.steady.receptances import Receptances
from engine.table import ClickEntry, Clicks
from engine.table.best_rows import BestRows, write_best_rows
from engine.table.click_columns import write_clicks
from engine.table.file import TableWriter, Variable
from engine.table.receptance_columns import write_receptances
from tests.engine.made_clicks import TOLERANCE_M, made_clicks

PLAIN = {"created": "2024-01-01", "code_fingerprint": "c0de", "code_version": "1"}


def receptances_of(device: Device, response: float = 1.0) -> Receptances:
    """Receptances at the frequencies and places of a stiff bar on springs: every place moves alike."""
    frequency_hz, place_m = np.linspace(60.0, 300.0, 25), np.linspace(0.0, device.bar.length_m, 9)
    shape = (len(place_m), len(device.actuators), len(frequency_hz))
    # Each actuator moves its own end most, so that fingers can be told apart.
    at = np.linspace(0.2, 1.0, len(place_m))
    reach = np.stack([at[::-1] if actuator % 2 == 0 else at for actuator in range(shape[1])], axis=1)
    turned = np.exp(-0.5j * np.arange(shape[1]))[None, :, None]
    pairs = len(place_m) * (len(place_m) + 1) // 2
    return Receptances(
        frequency_hz=frequency_hz,
        threshold_m_per_s2=np.full(len(frequency_hz), 0.15),
        place_m=place_m,
        drive=(1e-6 * response * reach[:, :, None] * turned * np.ones(shape)).astype(np.complex64),
        point=np.full((pairs, len(frequency_hz)), 1e-6 * (1 - 0.1j), dtype=np.complex64),
    )


def write_table(
    path: Path,
    device: Device,
    clicks: Clicks | Sequence[ClickEntry] = (),
    *,
    response: float = 1.0,
    others: Mapping[str, float] | None = None,
    rows: BestRows | None = None,
    **attributes: str,
) -> Path:
    """Write it; `response` is every acceleration of it, `attributes` replace those in PLAIN, `others` are groups."""
    held = clicks if isinstance(clicks, Clicks) else made_clicks(device, clicks)
    lengths = {"click_pitch_m": held.places.pitch_m, "click_tolerance_m": held.tolerance_m or TOLERANCE_M}
    everywhere = np.full((2, len(device.actuators), len(device.zones), 2, 2), response)
    with TableWriter(path) as writer:
        own = {"device_name": device.name, "device_description": device.text, "device_fingerprint": device.fingerprint}
        writer.describe({**PLAIN, **own, **lengths, **attributes})
        for name, dimensions, values in (
            ("frequency", ("frequency",), np.array([100.0, 200.0])),
            ("position", ("zone", "point"), np.array([[zone.start_m, zone.stop_m] for zone in device.zones])),
            ("acceleration", ("frequency", "actuator", "zone", "point", "part"), everywhere),
        ):
            writer.write("responses", Variable(name, dimensions, "1", "made by hand"), values)
        writer.write("responses", Variable.names("actuator"), [actuator.name for actuator in device.actuators])
        write_receptances(writer, receptances_of(device, response), device)
        if rows is not None:
            write_best_rows(writer, rows, device)
        for group, number in (others or {}).items():
            writer.write(group, Variable("number", (), "1", "made by hand"), np.array(number))
        if held:
            write_clicks(writer, held, device)
    return path
