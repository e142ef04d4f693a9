"""A device description in TOML to a `Device`, validated once; every error names key, value and what was expected."""

import difflib
import itertools
import math
import re
import reprlib
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from engine.device import Actuator, Bar, Device, DeviceError, Finger, Limits, Sweep, TouchAxis, Zone
from engine.quantity import QuantityError, read_quantity

ROMAN = ("I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII", "XIII", "XIV", "XV", "XVI")
_LARGEST_SPREAD = 1000
_MISSPELT = 0.8  # as alike as a misspelt key; keys that are meant differ more
_MOST_STEPS = 100_000
_SHORTEST_ZONE = 1e-3
_LEAST_DISTANCE = 1e-3
_Part = TypeVar("_Part")


class _Section:
    """One TOML table being read: every key is asked for once, what was not asked for is refused at the end."""

    def __init__(self, source: str, path: str, table: object) -> None:
        self.source, self.path = source, path
        if not isinstance(table, dict):
            raise self.error("", table, f"expected a table [{path}]")
        self.left: dict[str, Any] = dict(table)
        self.known: list[str] = []
        marks = self.left.pop("inferred", [])
        if not (isinstance(marks, list) and all(isinstance(mark, str) for mark in marks)):
            raise self.error("inferred", marks, "expected a list of keys of this table")
        self.marks: list[str] = marks

    def error(self, key: str, value: object, expected: str) -> DeviceError:
        where = ".".join(part for part in (self.path, key) if part)
        return DeviceError(f"{self.source}: {where}: {reprlib.repr(value)}: {expected}")

    def take(self, key: str, default: Any = None) -> Any:
        self.known.append(key)
        if key in self.left:
            return self.left.pop(key)
        if default is None:
            for near in difflib.get_close_matches(key, self.left, 1, _MISSPELT):
                raise self.error(near, self.left[near], f"unknown key; did you mean {key!r}?")
            raise DeviceError(f"{self.source}: {f'[{self.path}] ' if self.path else ''}has no key {key!r}")
        return default

    def quantity(
        self, key: str, unit: str, *, least: float = 0.0, exclusive: bool = False, default: str | None = None
    ) -> float:
        return self.checked(key, self.take(key, default), unit, least=least, exclusive=exclusive)

    def checked(self, key: str, text: object, unit: str, *, least: float = 0.0, exclusive: bool = False) -> float:
        try:
            value = read_quantity(text, unit)
        except QuantityError as error:
            raise DeviceError(f"{self.source}: {self.path + '.' if self.path else ''}{key}: {error}") from None
        if value < least or (exclusive and value == least):
            raise self.error(
                key, text, f"expected {'more than' if exclusive else 'at least'} {least:g} {unit}".rstrip()
            )
        return value

    def position(self, key: str, length_m: float, *, least: float = 0.0, default: str | None = None) -> float:
        """A place on the bar: a length from its start, or a percentage of its length; off it only with `least` < 0."""
        text = self.take(key, default)
        if isinstance(text, str) and text.rstrip().endswith("%"):
            value = self.checked(key, text, "", least=least) * length_m
        else:
            value = self.checked(key, text, "m", least=least)
        if value > length_m * (1 + 1e-12):
            raise self.error(key, text, f"is off the bar, which is {1e3 * length_m:g} mm long")
        return min(value, length_m)

    def integer(self, key: str, least: int, greatest: int, default: int | None = None) -> int:
        value = self.take(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= greatest:
            raise self.error(key, value, f"expected a whole number from {least} to {greatest}")
        return value

    def word(self, key: str, options: tuple[str, ...], default: str) -> str:
        value = self.take(key, default)
        if not isinstance(value, str) or value not in options:
            raise self.error(key, value, f"expected one of {', '.join(options)}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self.take(key, default)
        if not isinstance(value, bool):
            raise self.error(key, value, "expected true or false")
        return value

    def sentence(self, key: str) -> str:
        value = self.take(key, "")
        if not isinstance(value, str):
            raise self.error(key, value, "expected text")
        return value

    def name(self, key: str, default: str | None = None) -> str:
        value = self.take(key, default)
        if not isinstance(value, str) or not re.fullmatch(r"[^\s,;/][^,;/\n]{0,63}", value):
            raise self.error(key, value, "expected a short name without comma, semicolon or slash")
        return value

    def close(self) -> list[str]:
        """Refuse keys nobody asked for; the marked keys with their paths."""
        for key, value in self.left.items():
            near = difflib.get_close_matches(key, self.known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known keys are {', '.join(self.known)}"
            raise self.error(key, value, f"unknown key{hint}")
        for mark in self.marks:
            if mark not in self.known:
                raise self.error("inferred", mark, f"is no key of this table; its keys are {', '.join(self.known)}")
        return [".".join(part for part in (self.path, mark) if part) for mark in self.marks]


def read_device(path: Path) -> Device:
    """Read and validate the description of one bar. Raises DeviceError; OSError when there is no such file."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise DeviceError(f"{path}: not UTF-8 text: {error}") from error
    return parse_device(text, str(path))


def parse_device(text: str, source: str) -> Device:
    """Validate the description `text`; `source` names it in errors. Raises DeviceError."""
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers and nesting beyond what Python reads
        raise DeviceError(f"{source}: not TOML: {error}") from error
    top = _Section(source, "", table)
    inferred: list[str] = []

    def section(key: str, read: Callable[[_Section], _Part]) -> _Part:
        part = _Section(source, key, top.take(key))
        value = read(part)
        inferred.extend(part.close())
        return value

    name = top.name("name")
    description = top.sentence("description")
    bar = section("bar", _read_bar)
    actuators = _read_actuators(top, bar, inferred)
    zones, hysteresis_m = _read_zones(top, bar, inferred)
    sweep = section("sweep", _read_sweep)
    _check_bands(source, actuators, sweep)
    device = Device(
        name=name,
        description=description,
        bar=bar,
        actuators=actuators,
        zones=zones,
        zone_hysteresis_m=hysteresis_m,
        finger=section("finger", _read_finger),
        touch_axis=section("digitizer", lambda part: _read_touch_axis(part, bar)),
        sweep=sweep,
        limits=section("limits", _read_limits),
        inferred=tuple(inferred),
        text=text,
    )
    top.close()
    return device


def _read_bar(part: _Section) -> Bar:
    length_m = part.quantity("length", "m", exclusive=True)
    return Bar(
        length_m=length_m,
        width_m=part.quantity("width", "m", exclusive=True),
        thickness_m=part.quantity("thickness", "m", exclusive=True),
        youngs_modulus_pa=part.quantity("youngs_modulus", "Pa", exclusive=True),
        density_kg_per_m3=part.quantity("density", "kg/m^3", exclusive=True),
        mass_damping_per_s=part.quantity("mass_damping", "1/s"),
        stiffness_damping_s=part.quantity("stiffness_damping", "s"),
        largest_element_m=part.quantity("largest_element", "m", least=length_m / 2000, default="5 mm"),
    )


def _read_list(top: _Section, key: str) -> list[_Section]:
    tables = top.take(key)
    if not isinstance(tables, list) or not tables:
        raise top.error(key, tables, f"expected one or more [[{key}]] tables")
    return [_Section(top.source, f"{key}[{i}]", table) for i, table in enumerate(tables, 1)]


def _read_actuators(top: _Section, bar: Bar, inferred: list[str]) -> tuple[Actuator, ...]:
    actuators: list[Actuator] = []
    for i, part in enumerate(_read_list(top, "actuator"), 1):
        actuator = Actuator(
            name=part.name("name", f"actuator {i}"),
            position_m=part.position("position", bar.length_m),
            stiffness_n_per_m=part.quantity("stiffness", "N/m", exclusive=True),
            damping_n_s_per_m=part.quantity("damping", "N*s/m"),
            mass_kg=part.quantity("mass", "kg"),
            full_scale_m=part.quantity("full_scale", "m", exclusive=True),
            band_hz=_read_band(part),
        )
        for other in actuators:
            if other.name == actuator.name:
                raise part.error("name", actuator.name, "another actuator has this name")
            if abs(other.position_m - actuator.position_m) < _LEAST_DISTANCE * bar.length_m:
                raise part.error("position", f"{1e3 * actuator.position_m:g} mm", f"is the place of {other.name}")
        actuators.append(actuator)
        inferred.extend(part.close())
    return tuple(actuators)


def _read_band(part: _Section) -> tuple[float, float]:
    band = part.take("band")
    if not isinstance(band, list) or len(band) != 2:
        raise part.error("band", band, "expected two frequencies such as ['60 Hz', '300 Hz']")
    low_hz, high_hz = (part.checked("band", text, "Hz", exclusive=True) for text in band)
    if low_hz >= high_hz:
        raise part.error("band", band, "is empty: the first frequency must be below the second")
    return low_hz, high_hz


def _read_zones(top: _Section, bar: Bar, inferred: list[str]) -> tuple[tuple[Zone, ...], float]:
    part = _Section(top.source, "zones", top.take("zones", {}))
    hysteresis_m = part.quantity("hysteresis", "m", default="0 mm")
    if "zone" in top.left:
        if "count" in part.left:
            raise part.error("count", part.left["count"], "give either a count of equal zones or [[zone]] tables")
        zones = _read_zone_tables(top, bar, inferred)
    else:
        count = part.integer("count", 1, len(ROMAN))
        edges = np.linspace(0.0, bar.length_m, count + 1).tolist()
        zones = [Zone(n, a, b) for n, (a, b) in zip(ROMAN, itertools.pairwise(edges), strict=False)]
    inferred.extend(part.close())
    shortest = min(zones, key=lambda zone: zone.length_m)
    if hysteresis_m >= shortest.length_m / 2:
        raise part.error("hysteresis", f"{1e3 * hysteresis_m:g} mm", f"must be under half of zone {shortest.name}")
    return tuple(zones), hysteresis_m


def _read_zone_tables(top: _Section, bar: Bar, inferred: list[str]) -> list[Zone]:
    zones: list[Zone] = []
    parts = _read_list(top, "zone")
    if len(parts) > len(ROMAN):
        raise top.error("zone", len(parts), f"expected at most {len(ROMAN)} zones")
    for part, roman in zip(parts, ROMAN, strict=False):
        zone = Zone(part.name("name", roman), part.position("start", bar.length_m), part.position("stop", bar.length_m))
        if zone.stop_m <= zone.start_m:
            raise part.error(
                "stop", f"{1e3 * zone.stop_m:g} mm", f"expected more than start, {1e3 * zone.start_m:g} mm"
            )
        if zones and zone.start_m < zones[-1].stop_m:
            overlap = f"zone {zone.name} overlaps or precedes zone {zones[-1].name}, which stops at"
            raise part.error("start", f"{1e3 * zone.start_m:g} mm", f"{overlap} {1e3 * zones[-1].stop_m:g} mm")
        if zone.name in [other.name for other in zones]:
            raise part.error("name", zone.name, "another zone has this name")
        zones.append(zone)
        inferred.extend(part.close())
    return zones


def _read_sweep(part: _Section) -> Sweep:
    start_hz = part.quantity("start", "Hz", exclusive=True)
    stop_hz = part.quantity("stop", "Hz", least=start_hz, exclusive=True)
    step_hz = part.quantity("step", "Hz", exclusive=True)
    steps = (stop_hz - start_hz) / step_hz
    if steps > _MOST_STEPS:
        raise part.error("step", f"{step_hz:g} Hz", f"expected at most {_MOST_STEPS} steps")
    if steps < 1 - 1e-6 or abs(steps - round(steps)) > 1e-6 * steps:
        raise part.error("step", f"{step_hz:g} Hz", f"must divide the range {start_hz:g}-{stop_hz:g} Hz evenly")
    return Sweep(
        start_hz=start_hz,
        stop_hz=stop_hz,
        step_hz=step_hz,
        amplitude_steps=part.integer("amplitude_steps", 1, 100),
        phase_steps=part.integer("phase_steps", 4, 360, 36),
    )


def _check_bands(source: str, actuators: tuple[Actuator, ...], sweep: Sweep) -> None:
    for i, actuator in enumerate(actuators, 1):
        low_hz, high_hz = actuator.band_hz
        if not np.any((sweep.frequency_hz >= low_hz) & (sweep.frequency_hz <= high_hz)):
            grid = f"the sweep, {sweep.start_hz:g}-{sweep.stop_hz:g} Hz"
            raise DeviceError(f"{source}: actuator[{i}].band: {low_hz:g}-{high_hz:g} Hz: has no frequency of {grid}")


def _read_finger(part: _Section) -> Finger:
    spread = part.take("spread", 1.0)
    if isinstance(spread, bool) or not isinstance(spread, int | float) or not 1 <= spread <= _LARGEST_SPREAD:
        raise part.error("spread", spread, "expected a factor of at least 1, such as 3.0")
    return Finger(
        mass_kg=part.quantity("mass", "kg"),
        damping_n_s_per_m=part.quantity("damping", "N*s/m"),
        stiffness_n_per_m=part.quantity("stiffness", "N/m"),
        spread=float(spread),
    )


def _read_touch_axis(part: _Section, bar: Bar) -> TouchAxis:
    axis = part.word("axis", ("x", "y"), "x")
    # Below zero: the touch area reaches beyond that end of the bar.
    start_m = part.position("start_margin", bar.length_m, least=-math.inf, default="0 mm")
    end_m = part.position("end_margin", bar.length_m, least=-math.inf, default="0 mm")
    active_m = part.quantity("active_length", "m", exclusive=True) if "active_length" in part.left else None
    part.known.append("active_length")
    if active_m is not None and start_m + active_m <= 0:
        raise part.error("active_length", f"{1e3 * active_m:g} mm", f"ends before the bar, from {1e3 * start_m:g} mm")
    if start_m >= bar.length_m:
        raise part.error("start_margin", f"{1e3 * start_m:g} mm", "the margins leave nothing of the bar")
    if max(end_m, start_m + end_m) >= bar.length_m:
        raise part.error("end_margin", f"{1e3 * end_m:g} mm", "the margins leave nothing of the bar")
    if not math.isfinite(bar.length_m - start_m - end_m):
        raise part.error("end_margin", f"{1e3 * end_m:g} mm", "with start_margin, the touch area is not finite")
    return TouchAxis(
        axis="x" if axis == "x" else "y",
        flip=part.flag("flip", False),
        start_margin_m=start_m,
        end_margin_m=end_m,
        active_length_m=active_m,
    )


def _read_limits(part: _Section) -> Limits:
    amplitude = part.quantity("amplitude", "", exclusive=True, default="100 %")
    if amplitude > 1:
        raise part.error("amplitude", f"{100 * amplitude:g} %", "expected at most 100 % of full scale")
    return Limits(
        amplitude=amplitude,
        slew_per_s=1.0 / part.quantity("ramp", "s", least=1e-6),
        level_floor_m_per_s2=part.quantity("level_floor", "m/s^2"),
        lease_s=part.quantity("lease", "s", exclusive=True, default="40 ms"),
    )
