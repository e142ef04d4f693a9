"""A table to a picture of its rise times: how long from rest until every felt finger has what the entry promises."""

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter
from numpy.typing import NDArray

from engine.table import Entry, Table
from engine.touch import ZoneState
from tactable.figures.file import Picture
from tactable.figures.style import (
    COLOUR_MAP,
    CURVES,
    FINGER_NOTE,
    GREY,
    draw_note,
    finite,
    level_text,
    zone_names,
)

Array = NDArray[np.float64]

PROMPT_MS = (5.0, 50.0)
"""When tactile feedback should follow the touch (PHYSICS.md section 4: Kaaresoja 2014)."""
_WHITE_BELOW = 0.5


def plot_rise(table: Table, level_db: float) -> Picture:
    """Picture of all entries at one level: those of one and two fingers as a map, all of them as a distribution.

    Standard fingers, and the worst of the sampled ones. Between tabulated levels: the drive that is played there.
    """
    entries = table.entries_at(level_db)
    figure = Figure(figsize=(9.6, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_map(figure, left, table, level_db)
    _draw_distribution(right, entries)
    caption = f"{table.device.name}: rise times (t90) at {level_text(level_db)}"
    figure.suptitle(caption, fontsize="medium")
    draw_note(figure, table.device, FINGER_NOTE)
    standard_ms, worst_ms = _times_ms(entries)
    text = f"{standard_ms.min():.0f} to {standard_ms.max():.0f} ms, median {np.median(standard_ms):.0f} ms"
    return Picture(
        figure,
        _columns(table, entries),
        {
            "device": table.device.name,
            "fingerprint": table.fingerprint,
            "wanted_level_db": finite(level_db),
            "states": len(entries),
            "median_t90_s": float(np.median(standard_ms)) / 1e3,
            "median_worst_t90_s": float(np.median(worst_ms)) / 1e3,
            "share_within_50_ms": float((standard_ms <= PROMPT_MS[1]).mean()),
            "estimated": [FINGER_NOTE, *table.device.inferred],
        },
        f"{caption}: {text}; {100 * (standard_ms <= PROMPT_MS[1]).mean():.0f} % of {len(entries)} states "
        f"within {PROMPT_MS[1]:g} ms",
    )


def _times_ms(entries: Sequence[Entry]) -> tuple[Array, Array]:
    """Shape (entry,) each: with standard fingers, and the worst of the sampled touches."""
    return (
        1e3 * np.array([entry.t90_s for entry in entries]),
        1e3 * np.array([entry.worst_case.t90_s for entry in entries]),
    )


def _draw_map(figure: Figure, axes: Axes, table: Table, level_db: float) -> None:
    names = [zone.name for zone in table.device.zones]
    cells = [[table.entry_for([felt], [quiet] if quiet != felt else [], level_db) for quiet in names] for felt in names]
    shown = np.array([[1e3 * entry.t90_s for entry in row] for row in cells])
    image = axes.imshow(shown, cmap=COLOUR_MAP, norm=LogNorm(shown.min(), max(shown.max(), 1.01 * shown.min())))
    for felt, quiet in itertools.product(range(len(names)), repeat=2):
        entry = cells[felt][quiet]
        red, green, blue, _ = (float(part) for part in image.to_rgba(shown[felt, quiet]))
        is_dark = 0.3 * red + 0.6 * green + 0.1 * blue < _WHITE_BELOW
        axes.text(
            quiet,
            felt,
            f"{1e3 * entry.t90_s:.0f}\n({1e3 * entry.worst_case.t90_s:.0f})",
            ha="center",
            va="center",
            fontsize="small",
            color="white" if is_dark else "black",
            bbox={"boxstyle": "square,pad=0.1", "fc": to_hex((red, green, blue)), "ec": "none"},
        )
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="quiet finger in zone (diagonal: none)", ylabel="felt finger in zone")
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
