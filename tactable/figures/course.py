"""One entry started from rest: the level under every finger while the bar rises, and the contrast between them."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from engine.table import Entry, Table
from engine.touch import ZoneState
from precompute.entries.envelope import compute_envelopes
from precompute.entries.prediction import touched_zones
from precompute.entries.rise_time import compute_rise_model
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold import detection_threshold
from tactable.explain.words import rise_text
from tactable.figures.file import Picture
from tactable.figures.rise import PROMPT_MS
from tactable.figures.style import (
    BLACK,
    BLUE,
    GREY,
    STATE_COLOUR,
    Array,
    finish_picture,
    level_text,
    state_text,
    zone_lists,
)

_STEP_S = 5e-4
_LONGER, _SHORTEST_S = 2.5, 0.3
"""The time axis ends after this many rise times, but not before the shortest time."""
_LOWEST_DB = 40.0
"""How far the axis reaches below the greatest level."""
_STYLES = ("-", "--", "-.", ":")
_TINY = 1e-12


@dataclass(frozen=True)
class Rising:
    """time_s (time,); level_db (finger, time), dB above threshold; contrast_db (time,), None: nothing is quiet."""

    time_s: Array
    zones: tuple[int, ...]
    level_db: Array
    contrast_db: Array | None


def plot_course(table: Table, entry: Entry) -> Picture:
    """Picture of one entry of the table, its drive started at once, standard fingers on the bar."""
    device, rising = table.device, compute_rising(table, entry)
    has_contrast = rising.contrast_db is not None
    figure = Figure(figsize=(9, 6.0 if has_contrast else 4.2), layout="constrained")
    heights = [3, 2] if has_contrast else [1]
    panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    _draw_levels(panels[0], table, entry, rising)
    if rising.contrast_db is not None:
        _draw_contrast(panels[1], entry, rising.time_s, rising.contrast_db)
    panels[-1].set_xlabel("time from rest (ms)")
    words = f"risen after {rise_text(entry.t90_s)}{_contrast_text(entry, rising)}"
    return finish_picture(
        figure,
        device,
        f"{device.name}: {state_text(device, entry.states)}, {level_text(entry.wanted_level_db)}, from rest",
        words,
        _columns(table, entry, rising),
        {
            **zone_lists(device, entry.states),
            "wanted_level_db": entry.wanted_level_db,
            "t90_s": entry.t90_s,
            "contrast_db": entry.contrast_db,
            "contrast_after_50_ms_db": None if rising.contrast_db is None else _after(rising, PROMPT_MS[1]),
        },
        subtitle=words,
    )


def compute_rising(table: Table, entry: Entry) -> Rising:
    """Levels of tones of different frequencies add as powers, as in the entry."""
    device, zones = table.device, touched_zones(entry.states)
    middle_m = [(device.zones[zone].start_m + device.zones[zone].stop_m) / 2 for zone in zones]
    load = [(at, device.finger) for at in middle_m]
    model = compute_rise_model(compute_basis(assemble(device)), [load], np.array([middle_m]))
    time_s = np.arange(_STEP_S, max(_SHORTEST_S, _LONGER * entry.t90_s), _STEP_S)
    amplitude = np.array(entry.amplitudes) * np.exp(1j * np.array(entry.phases_rad))
    tones_hz, envelope = compute_envelopes(model, np.array(entry.frequencies_hz), amplitude, time_s)
    power = ((envelope[:, 0] / detection_threshold(tones_hz)[:, None, None]) ** 2).sum(axis=0)
    level_db: Array = 10 * np.log10(np.maximum(power, _TINY))
    states = [entry.states[zone] for zone in zones]
    felt, quiet = (np.array([state is kind for state in states]) for kind in (ZoneState.FELT, ZoneState.QUIET))
    contrast_db = level_db[felt].min(axis=0) - level_db[quiet].max(axis=0) if quiet.any() else None
    return Rising(time_s, zones, level_db, contrast_db)


def _draw_levels(axes: Axes, table: Table, entry: Entry, rising: Rising) -> None:
    _draw_prompt(axes)
    drawn = {ZoneState.FELT: 0, ZoneState.QUIET: 0}
    for zone, level_db in zip(rising.zones, rising.level_db, strict=True):
        kind = entry.states[zone]
        style = _STYLES[drawn[kind] % len(_STYLES)] if kind is ZoneState.FELT else _STYLES[(drawn[kind] + 1) % 4]
        drawn[kind] += 1
        name = f"{table.device.zones[zone].name} {kind.name.lower()}"
        axes.plot(1e3 * rising.time_s, level_db, color=STATE_COLOUR[kind], ls=style, lw=1.6, label=name)
        promised_db = entry.zones[zone].sensation_level_db
        if promised_db is not None:
            axes.plot(1e3 * rising.time_s[-1], promised_db, "<", ms=8, color=STATE_COLOUR[kind], clip_on=False)
    axes.plot([], [], "<", ms=8, color=BLACK, label="promised")
    axes.axvline(1e3 * entry.t90_s, color=BLACK, ls=":", lw=1.2, label=f"t90, {1e3 * entry.t90_s:.0f} ms")
    axes.axhline(0.0, color=GREY, lw=1.2, ls="--", label="detection threshold (ESTIMATE)")
    top_db = float(rising.level_db.max())
    axes.set(ylabel="level (dB above threshold)", ylim=(top_db - _LOWEST_DB, top_db + 3.0))
    axes.set_xlim(0, 1e3 * rising.time_s[-1])
    axes.grid(alpha=0.25)
    axes.legend(fontsize="x-small", loc="lower right", ncols=2)


def _draw_contrast(axes: Axes, entry: Entry, time_s: Array, contrast_db: Array) -> None:
    _draw_prompt(axes)
    axes.plot(1e3 * time_s, contrast_db, color=BLUE, lw=1.6)
    assert entry.contrast_db is not None
    axes.plot(1e3 * time_s[-1], entry.contrast_db, "<", ms=8, color=BLACK, clip_on=False)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.axvline(1e3 * entry.t90_s, color=BLACK, ls=":", lw=1.2)
    axes.set(ylabel="contrast, felt over\nquiet, at that moment (dB)")
    axes.grid(alpha=0.25)


def _draw_prompt(axes: Axes) -> None:
    axes.axvspan(*PROMPT_MS, color=GREY, alpha=0.25, lw=0, label="5 to 50 ms: prompt feedback")


def _after(rising: Rising, time_ms: float) -> float:
    assert rising.contrast_db is not None
    return float(np.interp(time_ms / 1e3, rising.time_s, rising.contrast_db))


def _contrast_text(entry: Entry, rising: Rising) -> str:
    if rising.contrast_db is None:
        return ""
    early_db = _after(rising, PROMPT_MS[1])
    return f"; contrast {early_db:z.1f} dB after {PROMPT_MS[1]:g} ms, {entry.contrast_db:z.1f} dB steady"


def _columns(table: Table, entry: Entry, rising: Rising) -> dict[str, Array]:
    columns = {"time (s)": rising.time_s}
    for zone, level_db in zip(rising.zones, rising.level_db, strict=True):
        name = f"{table.device.zones[zone].name} {entry.states[zone].name.lower()}"
        columns[f"level of {name} (dB above threshold)"] = level_db
    if rising.contrast_db is not None:
        columns["contrast (dB)"] = rising.contrast_db
    return columns
