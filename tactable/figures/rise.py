"""Rise times (t90) of a table: how long a drive takes from rest until every felt finger has its steady level."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter
from numpy.typing import NDArray

from engine.table import Entry, Table
from engine.touch import ZoneState
from tactable.explain.words import rise_ms
from tactable.figures.file import Picture
from tactable.figures.style import (
    COLOUR_MAP,
    CURVES,
    FINGER_NOTE,
    GREY,
    finish_picture,
    level_text,
    zone_names,
)
from tactable.figures.zone_map import colour_of, draw_cell, label_zones, pair_entries, pairs_of

Array = NDArray[np.float64]

PROMPT_MS = (5.0, 50.0)
"""When tactile feedback should follow the touch (Kaaresoja, Brewster & Lantz 2014, doi 10.1145/2611387)."""
_WHITE_BELOW = 0.5


def plot_rise(table: Table, level_db: float) -> Picture:
    """Picture of all entries at one level: one and two fingers as a map, all states as a distribution.

    Standard fingers, and the worst of the sampled ones. Between tabulated levels: the drive that is played there.
    """
    entries = table.entries_at(level_db)
    figure = Figure(figsize=(9.6, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_map(figure, left, table, level_db)
    _draw_distribution(right, entries)
    standard_ms, worst_ms = _times_ms(entries)
    within = float((standard_ms <= PROMPT_MS[1]).mean())
    return finish_picture(
        figure,
        table.device,
        f"{table.device.name}: rise times (t90) at {level_text(level_db)}",
        f"{standard_ms.min():.0f} to {standard_ms.max():.0f} ms, median {np.median(standard_ms):.0f} ms; "
        f"{100 * within:.0f} % of {len(entries)} states within {PROMPT_MS[1]:g} ms",
        _columns(table, entries),
        {
            "wanted_level_db": level_db,
            "states": len(entries),
            "median_t90_s": float(np.median(standard_ms)) / 1e3,
            "median_worst_t90_s": float(np.median(worst_ms)) / 1e3,
            "share_within_50_ms": within,
        },
        notes=(FINGER_NOTE,),
    )


def _times_ms(entries: Sequence[Entry]) -> tuple[Array, Array]:
    """Shape (entry,) each: with standard fingers, and the worst of the sampled touches."""
    return (
        1e3 * np.array([entry.t90_s for entry in entries]),
        1e3 * np.array([entry.worst_case.t90_s for entry in entries]),
    )


def _draw_map(figure: Figure, axes: Axes, table: Table, level_db: float) -> None:
    names = [zone.name for zone in table.device.zones]
    cells = pair_entries(table, names, level_db)
    shown = np.array([[1e3 * entry.t90_s for entry in row] for row in cells])
    image = axes.imshow(shown, cmap=COLOUR_MAP, norm=LogNorm(shown.min(), max(shown.max(), 1.01 * shown.min())))
    for felt, quiet in pairs_of(names):
        entry, ground = cells[felt][quiet], colour_of(image, shown[felt, quiet])
        text = f"{rise_ms(entry.t90_s)}\n({rise_ms(entry.worst_case.t90_s)})"
        is_dark = np.dot((0.3, 0.6, 0.1), to_rgb(ground)) < _WHITE_BELOW
        draw_cell(axes, (felt, quiet), ((0.0, text, "small"),), (ground, "white" if is_dark else "black"))
    label_zones(axes, names, quiet_label="quiet finger in zone (diagonal: none)", felt_label="felt finger in zone")
    axes.set_title("standard fingers, in brackets the worst sampled (ms)", fontsize="small", loc="left")
    bar = figure.colorbar(image, ax=axes, label="t90 (ms)", shrink=0.8)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter(ScalarFormatter())
    bar.ax.yaxis.set_minor_locator(NullLocator())


def _draw_distribution(axes: Axes, entries: Sequence[Entry]) -> None:
    """Percent of the states that have risen by a time."""
    axes.axvspan(*PROMPT_MS, color=GREY, alpha=0.3, lw=0, label="5 to 50 ms: prompt feedback")
    names = ("standard fingers", "worst of the sampled fingers")
    for times_ms, name, (colour, style) in zip(_times_ms(entries), names, CURVES, strict=False):
        rising = np.sort(times_ms)
        risen = 100 * np.arange(1, len(rising) + 1) / len(rising)
        axes.step(rising, risen, where="post", color=colour, ls=style, lw=1.7, label=name)
    axes.set(xscale="log", xlabel="time from rest (ms)", ylabel=f"risen, of {len(entries)} states (%)", ylim=(0, 102))
    axes.grid(alpha=0.25)
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.legend(fontsize="x-small", loc="upper left")
    axes.set_title("every state of the table", fontsize="small", loc="left")


def _columns(table: Table, entries: Sequence[Entry]) -> dict[str, Sequence[object]]:
    device = table.device
    return {
        "felt zones": [" ".join(zone_names(device, entry.states, ZoneState.FELT)) for entry in entries],
        "quiet zones": [" ".join(zone_names(device, entry.states, ZoneState.QUIET)) for entry in entries],
        "t90 (s)": [entry.t90_s for entry in entries],
        "worst t90 (s)": [entry.worst_case.t90_s for entry in entries],
        "family": [entry.family for entry in entries],
        "level (dB above threshold)": [entry.level_db for entry in entries],
        "achieved (1)": [int(entry.achieved) for entry in entries],
    }
