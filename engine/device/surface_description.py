"""The tables of a device file that say what fingers touch: bar or plate, its zones, and how the digitizer lies."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from base.points import point_at, point_text
from engine.device.description import DeviceTable
from engine.device.parts import Bar, Plate, Surface, Sweep, TouchAcross, TouchAxis, Zone

ROMAN = ("I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII", "XIII", "XIV", "XV", "XVI")
CLICKS_TOP_HZ = 2000.0  # half the rate of a click's waveform, beyond which no click has power
_ELEMENTS_PER_WAVE, _ELEMENTS_PER_WAVE_OF_CLICKS = 24, 10
"""Responses are then right to 0.03 % of the greatest, at resonances too; tests/precompute/model/test_assembly.py."""
_SLENDER = 5  # the theory of beams neglects shear, which counts from about a tenth on
_MOST_ELEMENTS = 2000  # shipped bars need 27 to 46; bounds time and memory where a length or an element is a slip
_MOST_POISSON = 0.5
_SHORTEST_SILENCE_S = 0.03  # digitizers report every 2 to 26 ms
_LONGEST_DEBOUNCE_S = _LONGEST_LATENCY_S = 0.1  # fingers tap more slowly


def read_surface(top: DeviceTable, sweep: Sweep) -> Surface:
    """The table [bar] or [plate]."""
    if "plate" not in top.left:
        return top.section("bar", lambda part: read_bar(part, sweep))
    if "bar" in top.left:
        raise top.error("plate", "beside [bar]", "a device is one surface: give one of them")
    top.known.append("bar")
    return top.section("plate", _read_plate)


def _read_plate(part: DeviceTable) -> Plate:
    plate = Plate(
        length_m=part.quantity("length", "m", exclusive=True),
        width_m=part.quantity("width", "m", exclusive=True),
        thickness_m=part.quantity("thickness", "m", exclusive=True),
        youngs_modulus_pa=part.quantity("youngs_modulus", "Pa", exclusive=True),
        density_kg_per_m3=part.quantity("density", "kg/m^3", exclusive=True),
        poissons_ratio=part.quantity("poissons_ratio", ""),
        mass_damping_per_s=part.quantity("mass_damping", "1/s"),
        stiffness_damping_s=part.quantity("stiffness_damping", "s"),
        damping_of=part.word("damping_of", ("bar", "assembly"), "bar"),
    )
    if plate.poissons_ratio > _MOST_POISSON:
        raise part.error("poissons_ratio", f"{plate.poissons_ratio:g}", f"expected at most {_MOST_POISSON}")
    shorter_m = min(plate.length_m, plate.width_m)
    if plate.thickness_m > shorter_m / _SLENDER:
        thick = f"{1e3 * plate.thickness_m:g} mm"
        raise part.error("thickness", thick, f"expected at most 1/{_SLENDER} of the shorter side: plates are thinner")
    return plate


def read_bar(part: DeviceTable, sweep: Sweep) -> Bar:
    """The table [bar]. Where it does not give the largest element, that follows from the shortest waves."""
    length_m = part.quantity("length", "m", exclusive=True)
    bar = Bar(
        length_m=length_m,
        width_m=part.quantity("width", "m", exclusive=True),
        thickness_m=part.quantity("thickness", "m", exclusive=True),
        youngs_modulus_pa=part.quantity("youngs_modulus", "Pa", exclusive=True),
        density_kg_per_m3=part.quantity("density", "kg/m^3", exclusive=True),
        mass_damping_per_s=part.quantity("mass_damping", "1/s"),
        stiffness_damping_s=part.quantity("stiffness_damping", "s"),
        largest_element_m=length_m,
        damping_of=part.word("damping_of", ("bar", "assembly"), "bar"),
    )
    if bar.thickness_m > length_m / _SLENDER:
        thick = f"{1e3 * bar.thickness_m:g} mm"
        raise part.error("thickness", thick, f"expected at most 1/{_SLENDER} of the length: no beam is that thick")
    smallest_m = length_m / _MOST_ELEMENTS
    converged_m = max(default_element_m(bar, sweep.stop_hz), smallest_m)
    element_m = part.quantity("largest_element", "m", least=smallest_m, default=f"{converged_m!r} m")
    return replace(bar, largest_element_m=element_m)


def default_element_m(bar: Bar, top_hz: float) -> float:
    """Element length with which responses up to `top_hz`, and those of clicks, are converged.

    The relative error of a natural frequency is (k h)^4 / 1440 with cubic elements, so elements are counted in the
    shortest wave (docs/theory.md#model).
    """
    steady = _ELEMENTS_PER_WAVE * bar.wave_number_per_m(top_hz)
    clicks = _ELEMENTS_PER_WAVE_OF_CLICKS * bar.wave_number_per_m(CLICKS_TOP_HZ)
    return 2 * math.pi / max(steady, clicks, 2 * math.pi / bar.length_m)


def read_zones(part: DeviceTable, top: DeviceTable, surface: Surface) -> tuple[tuple[Zone, ...], float]:
    """The zones, from the [[zone]] tables of `top` or all of one size, and their hysteresis in metres."""
    hysteresis_m = part.quantity("hysteresis", "m", default="0 mm")
    keys = ("count",) if isinstance(surface, Bar) else ("rows", "columns")
    if "zone" in top.left:
        for key in keys:
            if key in part.left:
                raise part.error(key, part.left[key], f"give {' and '.join(keys)} of equal zones or [[zone]] tables")
        zones = _read_zone_tables(top, surface)
    else:
        zones = _equal_zones(part, surface)
    for zone in zones:
        span_m = zone.stop_m - zone.start_m
        narrow_m = span_m.real if isinstance(surface, Bar) else min(span_m.real, span_m.imag)
        if hysteresis_m >= narrow_m / 2:
            raise part.error("hysteresis", f"{1e3 * hysteresis_m:g} mm", f"must be under half of zone {zone.name}")
    return tuple(zones), hysteresis_m


def equal_zones(surface: Surface, columns: int, rows: int = 1) -> tuple[Zone, ...]:
    """Zones of one size, at most 16, named by Roman numerals: along the surface, row by row from its first corner."""
    corners_m = [
        [point_at(surface.corner_m, (column + far) / columns, (row + far) / rows) for far in (0, 1)]
        for row, column in itertools.product(range(rows), range(columns))
    ]
    return tuple(Zone(name, *ends_m) for name, ends_m in zip(ROMAN, corners_m, strict=False))


def _equal_zones(part: DeviceTable, surface: Surface) -> Sequence[Zone]:
    """Zones of a bar by their `count`; of a plate by `rows` and `columns`."""
    if isinstance(surface, Bar):
        return equal_zones(surface, part.integer("count", 1, len(ROMAN)))
    rows, columns = part.integer("rows", 1, len(ROMAN)), part.integer("columns", 1, len(ROMAN))
    if rows * columns > len(ROMAN):
        raise part.error("rows", rows, f"expected at most {len(ROMAN)} zones")
    return equal_zones(surface, columns, rows)


def _read_zone_tables(top: DeviceTable, surface: Surface) -> Sequence[Zone]:
    zones: list[Zone] = []
    parts = top.tables("zone")
    if len(parts) > len(ROMAN):
        raise top.error("zone", len(parts), f"expected at most {len(ROMAN)} zones")
    for part, roman in zip(parts, ROMAN, strict=False):
        ends = part.point("start", surface.corner_m), part.point("stop", surface.corner_m)
        zone = Zone(part.name("name", roman), *ends)
        span_m = zone.stop_m - zone.start_m
        if span_m.real <= 0 or (isinstance(span_m, complex) and span_m.imag <= 0):
            raise part.error("stop", point_text(zone.stop_m), f"expected more than start, {point_text(zone.start_m)}")
        if isinstance(surface, Bar) and zones and zone.start_m.real < zones[-1].start_m.real:
            raise part.error("start", point_text(zone.start_m), f"zone {zone.name} precedes zone {zones[-1].name}")
        for other in zones:
            if _overlap(zone, other):
                reach = f"zone {other.name}, which lies from {point_text(other.start_m)} to {point_text(other.stop_m)}"
                raise part.error("start", point_text(zone.start_m), f"zone {zone.name} overlaps {reach}")
            if zone.name == other.name:
                raise part.error("name", zone.name, "another zone has this name")
        zones.append(zone)
        part.close()
    return zones


def _overlap(one: Zone, other: Zone) -> bool:
    along = one.start_m.real < other.stop_m.real and other.start_m.real < one.stop_m.real
    if not isinstance(one.start_m, complex):
        return along
    return along and one.start_m.imag < other.stop_m.imag and other.start_m.imag < one.stop_m.imag


def read_touch_axis(part: DeviceTable, surface: Surface) -> TouchAxis:
    """The table [digitizer]; of a plate it says with the keys `..._across` how the digitizer lies across it."""
    part.assume("axis", "flip", "start_margin", "end_margin")
    axis: Literal["x", "y"] = part.word("axis", ("x", "y"), "x")
    flip = part.flag("flip", False)
    start_m, end_m, active_m = _read_margins(part, "", surface.length_m, surface.kind)
    across = None
    if not isinstance(surface, Bar):
        part.assume("flip_across", "start_margin_across", "end_margin_across")
        across = TouchAcross(part.flag("flip_across", False), *_read_margins(part, "_across", surface.width_m, "plate"))
    silence_s = part.quantity("silence", "s", least=_SHORTEST_SILENCE_S) if part.has("silence") else None
    debounce_s = part.quantity("debounce", "s", default="0 ms")
    if debounce_s > _LONGEST_DEBOUNCE_S:
        expected = f"expected up to {1e3 * _LONGEST_DEBOUNCE_S:g} ms: a second tap must be one"
        raise part.error("debounce", f"{1e3 * debounce_s:g} ms", expected)
    latency_s = part.quantity("latency", "s", default="0 ms")
    if latency_s > _LONGEST_LATENCY_S:
        raise part.error("latency", f"{1e3 * latency_s:g} ms", f"expected up to {1e3 * _LONGEST_LATENCY_S:g} ms")
    return TouchAxis(
        axis=axis,
        flip=flip,
        start_margin_m=start_m,
        end_margin_m=end_m,
        active_length_m=active_m,
        silence_s=silence_s,
        debounce_s=debounce_s,
        latency_s=latency_s,
        across=across,
    )


def _read_margins(part: DeviceTable, suffix: str, length_m: float, kind: str) -> tuple[float, float, float | None]:
    """Margins at start and end and, where the file gives it, the active length of the touch area."""
    start, end, active = f"start_margin{suffix}", f"end_margin{suffix}", f"active_length{suffix}"
    # Below zero: the touch area reaches beyond that end of the surface.
    start_m = part.position(start, length_m, least=-math.inf, default="0 mm")
    end_m = part.position(end, length_m, least=-math.inf, default="0 mm")
    active_m = part.quantity(active, "m", exclusive=True) if part.has(active) else None
    if active_m is not None and start_m + active_m <= 0:
        raise part.error(active, f"{1e3 * active_m:g} mm", f"ends before the {kind}, from {1e3 * start_m:g} mm")
    if start_m >= length_m:
        raise part.error(start, f"{1e3 * start_m:g} mm", f"the margins leave nothing of the {kind}")
    if max(end_m, start_m + end_m) >= length_m:
        raise part.error(end, f"{1e3 * end_m:g} mm", f"the margins leave nothing of the {kind}")
    return start_m, end_m, active_m
