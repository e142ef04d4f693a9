"""Explanation of an entry, as a page or as JSON: drive, prediction, worst case, and the alternatives that lost."""

import math
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from engine.device import Device, Zone
from engine.plain import to_plain
from engine.table import Entry, Table
from engine.table.entry import LONGEST_RISE_S, EntrySpread
from engine.touch import ZoneState
from precompute.entries.alternatives import Alternative
from precompute.entries.prediction import SHARES, objective_value
from precompute.sampling.fingers import SAMPLES
from tactable.explain.words import level_text, model_figures, model_text, rise_text, state_text

_DRIVE = ("frequencies_hz", "amplitudes", "phases_rad")
_OWN = ("wanted_level_db", "achieved", "objective", "upper_bound", "optimality_gap_db", "limited_by", "worst_case")
_COMPARED = ("family", "level_db", "localized_factor", "contrast_db", "expected_contrast_db", "t90_s")


def entry_json(table: Table, entry: Entry, alternatives: Sequence[Alternative]) -> dict[str, Any]:
    """The entry as plain values for JSON; infinite levels are None."""
    values: dict[str, Any] = to_plain(
        {
            "device": table.device.name,
            "fingerprint": table.fingerprint,
            "state": entry.index,
            "objective_value": objective_value(entry),
            **{key: getattr(entry, key) for key in _OWN},
            **_compared(entry),
            "spread": entry.spread and {**to_plain(entry.spread), "over": str(table.attributes["spread_over"])},
            "zones": [{**to_plain(zone), "state": zone.state.name.lower()} for zone in entry.zones],
            "alternatives": [
                {"name": rival.name, "lost_by": rival.lost_by, **_compared(rival.entry)} for rival in alternatives
            ],
            "model": model_figures(table),
            "threshold": table.device.threshold.title,
            "estimated": [*table.device.estimated_values, "detection threshold"],
        }
    )
    values["worst_case"]["fingers"] = SAMPLES
    for part in (values, values["worst_case"], *values["alternatives"]):
        part["t90_is_lower_bound"] = part["t90_s"] >= LONGEST_RISE_S
    return values


def _compared(entry: Entry) -> dict[str, Any]:
    """The drive of an entry and the figures by which entries are compared."""
    return {"drive": {key: getattr(entry, key) for key in _DRIVE}, **{key: getattr(entry, key) for key in _COMPARED}}


def print_entry(out: Console, table: Table, entry: Entry, alternatives: Sequence[Alternative]) -> None:
    """Print the drive, its prediction for every finger, the worst case, and the alternatives."""
    device, worst = table.device, entry.worst_case
    state = state_text(device, [zone.state for zone in entry.zones])
    out.print(f"{device.name}, {state}: {entry.family}, {level_text(entry.wanted_level_db)} wanted")
    for line in _drive_lines(device, entry):
        out.print(f"  {line}", highlight=False)
    level = f"weakest felt finger {entry.level_db:.1f} dB {device.threshold.above}"
    if entry.contrast_db is not None and entry.expected_contrast_db is not None:
        level += f", contrast {entry.contrast_db:.1f} dB, expected {entry.expected_contrast_db:.1f} dB"
    out.print(level, highlight=False)
    out.print(
        f"localized factor {entry.localized_factor:.4f}, t90 {rise_text(entry.t90_s)}; maximised: {entry.objective}, "
        f"{_bound_words(entry)}",
        highlight=False,
    )
    out.print(f"limited by: {entry.limited_by}{'' if entry.achieved else ' - NOT ACHIEVED, the best possible'}")
    out.print(_zone_grid(entry))
    quiet = "" if worst.quiet_level_db is None else f", quiet up to {worst.quiet_level_db:.1f} dB"
    contrast = "" if worst.contrast_db is None else f", contrast down to {worst.contrast_db:.1f} dB"
    out.print(
        f"worst over {SAMPLES} other fingers (anywhere in their zones, {device.finger.spread:g}-fold spread): "
        f"felt from {worst.level_db:.1f} dB{quiet}{contrast}, localized factor {worst.localized_factor:.3f}, "
        f"t90 {rise_text(worst.t90_s)}",
        highlight=False,
        soft_wrap=True,
    )
    if entry.spread is not None:
        out.print(_spread_words(table, entry.spread), highlight=False, soft_wrap=True)
    if alternatives:
        out.print(_alternative_grid(alternatives))
    middles = ",".join(f"{500 * (z.start_m + z.stop_m):.4g}mm" for z in _felt_zones(device, entry))
    out.print(
        f"a run solves its drives for the positions of the fingers: --felt {middles} shows that of the middle",
        style="dim",
        highlight=False,
        soft_wrap=True,
    )
    out.print(model_text(table), style="dim", highlight=False)
    estimates = ", ".join([*device.estimated_values, device.threshold.title])
    out.print(f"ESTIMATES: {estimates}", style="dim")


def _felt_zones(device: Device, entry: Entry) -> list[Zone]:
    return [zone for zone, state in zip(device.zones, entry.states, strict=True) if state is ZoneState.FELT]


def _spread_words(table: Table, spread: EntrySpread) -> str:
    parts = (("felt", spread.felt), ("quiet", spread.quiet), ("contrast", spread.contrast))
    words = [f"{name} {p.low_db:.1f}, {p.middle_db:.1f}, {p.high_db:.1f} dB" for name, p in parts if p is not None]
    return f"5th, 50th and 95th percentile of the sampled cases: {'; '.join(words)} ({table.attributes['spread_over']})"


def _bound_words(entry: Entry) -> str:
    value = objective_value(entry)
    if value is None:
        return "for all but the worst 5 % of the sampled cases: no bound is claimed"
    digits, unit = (4, "") if entry.objective in SHARES else (2, " dB")
    rounded_up = math.ceil(entry.upper_bound * 10**digits) / 10**digits  # what is printed is a bound too
    reached, bound = f"{value:.{digits}f}{unit}", f"{rounded_up:.{digits}f}{unit}"
    return f"{reached} reached, upper bound {bound} (gap {entry.optimality_gap_db:.2f} dB)"


def _drive_lines(device: Device, entry: Entry) -> list[str]:
    return [
        f"{actuator.name}: {hz:.2f} Hz at {100 * amplitude:.1f} %, {phase:+.3f} rad"
        if amplitude
        else f"{actuator.name}: still"
        for actuator, hz, amplitude, phase in zip(
            device.actuators, entry.frequencies_hz, entry.amplitudes, entry.phases_rad, strict=True
        )
    ]


def _zone_grid(entry: Entry) -> Grid:
    grid = Grid("zone", "state", "share", "peak m/s²", "at mm", "finger m/s²", "level dB", "range dB")
    for zone in entry.zones:
        at_finger, ends = zone.acceleration_at_finger_m_per_s2, zone.sensation_level_range_db
        grid.add_row(
            zone.name,
            zone.state.name.lower(),
            f"{zone.share:.3f}",
            f"{zone.peak_acceleration_m_per_s2:.2f}",
            f"{1e3 * zone.peak_position_m:.1f}",
            "" if at_finger is None else f"{at_finger:.3f}",
            "" if zone.sensation_level_db is None else f"{zone.sensation_level_db:.1f}",
            "" if ends is None else f"{ends[0]:.1f} to {ends[1]:.1f}",
        )
    return grid


def _alternative_grid(alternatives: Sequence[Alternative]) -> Grid:
    grid = Grid("alternative", "drive", "level dB", "contrast dB", "expected dB", "factor", "lost: ")
    for rival in alternatives:
        entry = rival.entry
        tones = sorted({hz for hz, a in zip(entry.frequencies_hz, entry.amplitudes, strict=True) if a})
        grid.add_row(
            rival.name,
            f"{entry.family}, {' + '.join(f'{hz:g}' for hz in tones)} Hz",
            f"{entry.level_db:.1f}",
            "" if entry.contrast_db is None else f"{entry.contrast_db:.1f}",
            "" if entry.expected_contrast_db is None else f"{entry.expected_contrast_db:.1f}",
            f"{entry.localized_factor:.3f}",
            rival.lost_by,
        )
    return grid
