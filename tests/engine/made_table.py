"""A table made by hand, and its file: states of zones and rows for them, clicks whose waveform says the placement."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import chain, combinations
from math import inf
from pathlib import Path

import h5py
import numpy as np

from engine.device import Device
from engine.steady.modes import Modes
from engine.table import ClickEntry, Clicks
from engine.table.best_rows import BestRow, BestRows, write_best_rows
from engine.table.clicks import ClickFinger, LevelSpread
from engine.table.columns import write_clicks, write_modes
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.table.netcdf_file import _SEAL, TableWriter, Variable, _append_seal, _read_seal
from engine.touch import Placement, ZoneState
from engine.touch.placement import Key, Places
from firmware_link.protocol.basis import Basis, BasisSet

LEVEL_DB = DEFAULT_LEVEL_DB
PITCH_M, TOLERANCE_M = 28e-3, 15e-3
"""On the published bar the middle of every zone is one of these places."""
_NUMBERS = 30_000
PLAIN = {"created": "2024-01-01", "code_fingerprint": "c0de", "code_version": "1"}


def states_of(device: Device, felt: Sequence[int], quiet: Sequence[int] = ()) -> tuple[ZoneState, ...]:
    """State of every zone, from the indices of those that are not free."""
    return tuple(
        ZoneState.FELT if zone in felt else ZoneState.QUIET if zone in quiet else ZoneState.FREE
        for zone in range(len(device.zones))
    )


def state_index(states: Sequence[ZoneState]) -> int:
    """The states of all zones as one number: the sum of state times 3**zone, 0 when all are free."""
    return sum(int(state) * 3**zone for zone, state in enumerate(states))


def row_of(device: Device, zones: Sequence[int], level_db: float = LEVEL_DB, *, achieved: bool = True) -> BestRow:
    """A row of two frequencies: 100 Hz and more for more zones, and 2 Hz more for each dB."""
    hz = 100.0 + sum(1 << zone for zone in zones)
    each = tuple(1.0 + zone for zone in range(len(device.zones)))
    return BestRow(
        zones=tuple(zones),
        wanted_level_db=level_db,
        group="sweep",
        index=0,
        frequencies_hz=(hz, 150.0 + 2 * min(level_db, 60.0)),
        amplitudes=(0.5, 0.25),
        phases_rad=(0.0, 0.0),
        level_db=min(level_db, 40.0) if achieved else level_db - 5,
        achieved=achieved,
        localized_factor=0.5,
        limited_by="",
        shares=each,
        peaks_m_per_s2=each,
        dead_spots_m_per_s2=each,
    )


def rows_of(device: Device, levels_db: Sequence[float] = (LEVEL_DB,), short_of: Sequence[int] = ()) -> BestRows:
    """A row for every combination at every level; those with a zone in `short_of` do not reach it."""
    zones = range(len(device.zones))
    every = list(chain.from_iterable(combinations(zones, count + 1) for count in zones))
    rows = [
        row_of(device, each, level_db, achieved=not set(each) & set(short_of))
        for level_db in levels_db
        for each in every
    ]
    return BestRows(rows, device.limits.amplitude)


@cache
def basis_of(actuators: int, *counts: int) -> Basis:
    """A basis whose sums are the weight of the actuator at all samples but the ends; a set for each count of them."""
    sets = []
    for count in counts:
        functions = np.full((actuators, count), 2, np.int16)
        functions[:, [0, -1]] = 0
        sets.append(BasisSet(functions, np.arange(actuators, dtype=np.uint8)))
    return Basis(4000, tuple(sets))


def places_of(device: Device) -> Places:
    return Places.every(device.surface.corner_m, PITCH_M)


def in_zones(device: Device, felt: Sequence[int], quiet: Sequence[int] = ()) -> Placement:
    """A finger in the middle of each of these zones, at the nearest of the places."""
    places = places_of(device)
    names = ([device.zones[zone].name for zone in each] for each in (felt, quiet))
    return places.placement(places.key(Placement.named(device, *names)))


def number_of(device: Device, placement: Placement) -> int:
    key = places_of(device).key(placement)
    number = 0
    for code in key:
        number = (61 * number + code + 1) % _NUMBERS
    return 1 + number


def click_of(device: Device, placement: Placement, *, level_db: float = 26.0, count: int = 121) -> ClickEntry:
    """A click of a device for this placement: so many samples, the greatest is the number of the placement."""
    actuators = len(device.actuators)
    return ClickEntry(
        placement=placement,
        tolerance_m=TOLERANCE_M,
        basis=basis_of(actuators, count),
        basis_set=0,
        weights=np.full(actuators, number_of(device, placement), np.int16),
        fraction_bits=1,
        felt=LevelSpread(level_db + 2, level_db, level_db + 1.5, level_db + 3, level_db - 1),
        quiet=LevelSpread(-3.0, -5.0, -2.5, 0.5, 1.5) if placement.quiet else None,
        fingers=tuple(ClickFinger(1.5, level_db) for _ in placement.position_m),
        exceeds_s={10.0: 0.008, 20.0: 0.005, inf: 0.004},
        peak_s=0.02,
        residual_from_s=0.06,
        residual_db=-3.0,
    )


def made_clicks(device: Device, clicks: Iterable[ClickEntry]) -> Clicks:
    """The clicks of a table, from some that were made by hand."""
    return Clicks.of(places_of(device), list(clicks))


def every_click(device: Device, *, level_db: float = 26.0) -> Clicks:
    """A click for every placement of one and two fingers at different places, of which one at least feels."""
    places = places_of(device)
    codes = range(2 * places.count)
    keys: list[Key] = [(code,) for code in codes if code % 2]
    keys += [(one, other) for one in codes for other in codes if one // 2 < other // 2 and (one % 2 or other % 2)]
    return made_clicks(device, (click_of(device, places.placement(key), level_db=level_db) for key in keys))


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
