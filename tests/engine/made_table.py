"""A table file made by hand: clicks and rows as they are given, responses of one number, and two modes."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np

from engine.device import Device
from engine.steady.modes import Modes
from engine.table import ClickEntry, Clicks
from engine.table.best_rows import BestRows, write_best_rows
from engine.table.columns import write_clicks, write_modes
from engine.table.netcdf_file import _SEAL, TableWriter, Variable, _append_seal, _read_seal
from engine.touch.placement import Places
from tests.engine.made_clicks import TOLERANCE_M, made_clicks

PLAIN = {"created": "2024-01-01", "code_fingerprint": "c0de", "code_version": "1"}


def modes_of(device: Device, response: float = 1.0) -> Modes:
    """Two stiff functions, one greatest at each end, that all actuators move, so that fingers can be told apart."""
    frequency_hz, at = np.linspace(60.0, 300.0, 25), np.linspace(0.2, 1.0, 9)
    actuators = np.arange(len(device.actuators))
    drive = np.where(actuators % 2 == np.array([[1], [0]]), 1e-6 * response, 0.0) * np.exp(-0.5j * actuators)
    return Modes(
        frequency_hz=frequency_hz,
        threshold_m_per_s2=np.full(len(frequency_hz), 0.15),
        places=Places(device.surface.corner_m, len(at)),
        shape=np.stack([at, at[::-1]], axis=1).astype(np.float32),
        drive=(drive[:, :, None] * np.ones(len(frequency_hz))).astype(np.complex64),
        natural_frequency_hz=np.array([2000.0]),
        damping_per_s=np.zeros(1),
        at_actuator=np.ones((1, len(actuators))),
        damper_n_s_per_m=np.zeros(len(actuators)),
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
        write_modes(writer, modes_of(device, response), device)
        if rows is not None:
            write_best_rows(writer, rows, device)
        for group, number in (others or {}).items():
            writer.write(group, Variable("number", (), "1", "made by hand"), np.array(number))
        if held:
            write_clicks(writer, held, device)
    return path


def reseal(path: Path) -> Path:
    """Seal the file as it is now."""
    if _read_seal(path) is not None:
        path.write_bytes(path.read_bytes()[: -_SEAL.size])
    _append_seal(path)
    return path


def changed(whole: Path, target: Path, change: Callable[[h5py.File], object]) -> Path:
    """A sealed copy of a table that `change` was applied to."""
    target.write_bytes(whole.read_bytes())
    with h5py.File(target, "a") as file:
        change(file)
    return reseal(target)


def replace_array(file: h5py.File, name: str, values: object) -> None:
    """Put other values, of any kind and shape, in the place of an array; its labels stay."""
    labels = dict(file[name].attrs)
    del file[name]
    file[name] = values
    for key in ("units", "long_name", "crc32"):
        file[name].attrs[key] = labels[key]
