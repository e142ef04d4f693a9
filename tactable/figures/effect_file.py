"""An effect file and the effect that is played for it, over time: what the file asks for, and what becomes of it."""

import math
from typing import Any

import numpy as np

from engine.effects.files.conversion import Converted, Fate
from engine.effects.files.json_part import CLICK_MS, Kind
from engine.effects.rules import NS_PER_MS
from tactable.figures.picture_file import Picture
from tactable.figures.style import BLUE, GREEN, GREY, ORANGE, VERMILLION

LOWEST_DB = -12.0  # where the axis ends: what lies below the threshold is drawn down to here
_FATES = {Fate.KEPT: (GREEN, "o"), Fate.CHANGED: (ORANGE, "s"), Fate.JOINED: (BLUE, "D"), Fate.LOST: (VERMILLION, "X")}


def plot_effect_file(converted: Converted, full_level_db: float) -> Picture:
    """Draw the intensities of all events as levels, the clicks and drives of the effect, and each event's fate."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for report in converted.reports:
        points = [(1e3 * time_s, _level(intensity, full_level_db)) for time_s, intensity in report.event.points]
        if report.event.kind is Kind.CONTINUOUS:
            time_ms = np.linspace(points[0][0], points[-1][0], 400)
            course = np.interp(time_ms / 1e3, *np.array(report.event.points).T)
            levels_db = [_level(intensity, full_level_db) for intensity in course]
            axes.plot(time_ms, levels_db, color=GREY, lw=1, label="the file's envelope")
        colour, mark = _FATES[report.fate]
        at_ms, level_db = max(points, key=lambda point: point[1], default=(0.0, LOWEST_DB))
        # A transient and an envelope often begin together: the transient's mark is larger, and hollow.
        face, size = ("none", 10) if report.event.kind is Kind.TRANSIENT else (colour, 5)
        label = f"{report.fate} (hollow: transient)"
        axes.plot(at_ms, level_db, mark, color=colour, markerfacecolor=face, ms=size, zorder=4, label=label)
    rows = _draw_effect(axes, converted)
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))  # each word once
    axes.legend(named.values(), named, loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)
    axes.axhline(0.0, color="black", lw=0.8, ls=":")
    axes.set(xlabel="time (ms)", ylabel="level (dB above threshold)", ylim=(LOWEST_DB, None), xlim=(-5, None))
    caption = f"{converted.name} ({converted.pattern.format})"
    figure.suptitle(f"{caption}: {converted.summary}", fontsize="medium")
    columns = {name: [row[k] for row in rows] for k, name in enumerate(("start (ms)", "stop (ms)", "kind", "dB"))}
    return Picture(figure, columns, {}, f"{caption}: {converted.summary}")


def _level(intensity: float, full_level_db: float) -> float:
    level_db = full_level_db + 20 * math.log10(intensity) if intensity > 0 else LOWEST_DB
    return max(level_db, LOWEST_DB)


def _draw_effect(axes: Any, converted: Converted) -> list[tuple[float, float, str, float]]:
    """Draw the segments; (start, stop, kind, level) of each that is felt."""
    rows, at_ms = [], 0.0
    for segment in converted.segments:
        length_ms = CLICK_MS if segment.duration_ns is None else segment.duration_ns / NS_PER_MS
        if segment.level_db is not None:
            rows.append((at_ms, at_ms + length_ms, "click" if segment.is_click else "drive", segment.level_db))
            colour, label = (GREEN, f"click, {CLICK_MS} ms") if segment.is_click else (BLUE, "steady drive")
            axes.bar(at_ms, segment.level_db, length_ms, align="edge", color=colour, alpha=0.3, lw=0, label=label)
        at_ms += length_ms
    return rows
