"""Levels, fingers, zones and states of a table in words, for pages, pictures and JSON alike."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from base.points import point_text
from engine.device import Device, Threshold
from engine.steady import SteadyDrive
from engine.table import Table
from engine.table.best_rows import BestRow
from engine.touch import Placement, ZoneState
from engine.touch.finger_tracker import ZoneFinder

PERCENTILES = ("5 %", "50 %", "95 %")
_NAMED = 3  # estimates that are named; the others are counted


def finger_names(device: Device, placement: Placement) -> list[str]:
    """Each finger of a placement by its position and, in brackets, its zone, such as "35 mm (I)"."""
    return [
        point_text(finger["position_m"], 4) + ("" if finger["zone"] is None else f" ({finger['zone']})")
        for finger in placement_json(device, placement)
    ]


def finger_roles(device: Device, placement: Placement) -> list[str]:
    """Each finger with its role, such as "35 mm (I) felt"."""
    names = zip(finger_names(device, placement), placement.is_felt, strict=True)
    return [f"{name} {'felt' if is_felt else 'quiet'}" for name, is_felt in names]


def placement_text(device: Device, placement: Placement) -> str:
    """A placement in words, such as "35 mm (I) felt, 120 mm (III) quiet"; felt fingers come first."""
    names = finger_names(device, placement)
    felt, quiet = ([names[finger] for finger in which] for which in (placement.felt, placement.quiet))
    return ", ".join(f"{', '.join(fingers)} {role}" for fingers, role in ((felt, "felt"), (quiet, "quiet")) if fingers)


def placement_json(device: Device, placement: Placement) -> list[dict[str, Any]]:
    """Position, zone (None in a gap between zones) and role of each finger, for JSON."""
    zone_at = ZoneFinder(device).zone_at
    zones = [zone_at(at_m) for at_m in placement.position_m]
    return [
        {
            "position_m": at_m,
            "zone": None if zone is None else device.zones[zone].name,
            "role": "felt" if is_felt else "quiet",
        }
        for at_m, is_felt, zone in zip(placement.position_m, placement.is_felt, zones, strict=True)
    ]


def fingers_json(device: Device, placement: Placement, levels_db: Iterable[Sequence[float]]) -> list[dict[str, Any]]:
    """Each finger with its levels (finger, 4), nominal, then 5th, 50th and 95th percentile, for JSON."""
    names = ("nominal", *PERCENTILES)
    pairs = zip(placement_json(device, placement), levels_db, strict=True)
    return [{**finger, "level_db": dict(zip(names, levels, strict=True))} for finger, levels in pairs]


def finger_grid(
    device: Device, placement: Placement, columns: Sequence[str], levels_db: Iterable[Sequence[float]], caption: str
) -> Grid:
    """A row for each finger: its name, its role and its levels (finger, column)."""
    grid = Grid("finger", "role", *columns, caption=caption)
    for name, is_felt, levels in zip(finger_names(device, placement), placement.is_felt, levels_db, strict=True):
        grid.add_row(name, "felt" if is_felt else "quiet", *(f"{level_db:z.1f}" for level_db in levels))
    return grid


def drive_lines(device: Device, drive: SteadyDrive | BestRow) -> list[str]:
    """Drive of each actuator in words, a line each."""
    outputs = zip(device.actuators, drive.frequencies_hz, drive.amplitudes, drive.phases_rad, strict=True)
    return [
        f"  {actuator.name}: " + (f"{hz:.2f} Hz at {100 * size:.1f} %, {phase:+.3f} rad" if size else "still")
        for actuator, hz, size, phase in outputs
    ]


def drive_json(drive: SteadyDrive | BestRow) -> dict[str, Any]:
    """Frequencies, amplitudes and phases by actuator, for JSON."""
    return {key: getattr(drive, key) for key in ("frequencies_hz", "amplitudes", "phases_rad")}


def print_lines(out: Console, *lines: str) -> None:
    """Print lines of text that may be longer than the screen."""
    for line in lines:
        out.print(line, highlight=False, soft_wrap=True)


def print_estimates(out: Console, device: Device, threshold: Threshold) -> None:
    """Print what the figures rest on that was not measured."""
    text = f"{estimates_text(device)}; the threshold is one too: {threshold.title}"
    out.print(text, style="dim", highlight=False, soft_wrap=True)


def estimates_text(device: Device) -> str:
    """How many values of a device are estimates, and which matter most, in words."""
    from precompute.predict.estimates import SHARE, weigh_estimates

    number, weighed = len(device.estimated_values), weigh_estimates(device)[:_NAMED]
    if not number:
        return "no value of the device is marked as an estimate"
    most = ", ".join(f"{name} (by {100 * change:.2g} %)" for name, change in weighed)
    text = f"{number} values are ESTIMATES, which the file marks"
    return f"{text}; a change of {100 * SHARE:g} % moves responses most in {most}" if most else text


def level_text(level_db: float) -> str:
    """A level in words, such as "20 dB"; an infinite one is full scale."""
    return "full scale" if math.isinf(level_db) else f"{level_db:g} dB"


def rise_text(t90_s: float) -> str:
    """A rise time in words, such as "83 ms"; rises are not followed beyond LONGEST_RISE_S."""
    from precompute.predict.rise_time import LONGEST_RISE_S  # its kernels are compiled when it is imported

    return f"longer than {LONGEST_RISE_S:g} s" if t90_s >= LONGEST_RISE_S else f"{1e3 * t90_s:.0f} ms"


def zone_names(device: Device, placement: Placement, kind: ZoneState = ZoneState.FELT) -> list[str]:
    """Names of the zones that the fingers bring into one state."""
    states = placement.zone_states(device)
    return [zone.name for zone, state in zip(device.zones, states, strict=True) if state is kind]


def zone_lists(device: Device, placement: Placement) -> dict[str, list[str]]:
    """Names of the felt and of the quiet zones, for a summary."""
    return {kind.name.lower(): zone_names(device, placement, kind) for kind in (ZoneState.FELT, ZoneState.QUIET)}


def model_figures(table: Table) -> dict[str, int | float]:
    """Mesh or functions, and modes, that the table was made with; empty for a table that does not state them."""
    keys = ("mesh_elements", "mesh_longest_element_m", "ritz_functions", "modes", "click_modes")
    return {key: table.attributes[key].item() for key in keys if key in table.attributes}


def model_text(table: Table) -> str:
    """Mesh and modes of a table in words."""
    model = model_figures(table)
    if not model:
        return "the table does not state its mesh and modes"
    clicks = f", {model['click_modes']} for clicks" if "click_modes" in model else ""
    if "ritz_functions" in model:
        parts = f"{model['ritz_functions']} functions by Ritz's method"
    else:
        parts = f"{model['mesh_elements']} elements of up to {1e3 * model['mesh_longest_element_m']:.1f} mm"
    return f"model: {parts}, {model['modes']} modes{clicks}"
