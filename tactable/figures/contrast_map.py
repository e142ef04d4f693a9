"""A table to a picture of all its two-finger states: how much contrast one felt finger has over one quiet finger."""

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from engine.table import Entry, Table, TableError
from tactable.figures.file import Picture
from tactable.figures.style import (
    COLOUR_MAP,
    FINGER_NOTE,
    THRESHOLD_NOTE,
    draw_note,
    finite,
    level_text,
)

Cells = Sequence[Sequence[Entry]]
"""By felt zone, then quiet zone; on the diagonal one felt finger alone."""

_CELL_INCHES = 1.0
_MARGINS_INCHES = (2.2, 1.9)
_SINGLE_CELL = "0.92"
_HATCH = "//"


def plot_contrast_map(table: Table, level_db: float) -> Picture:
    """Picture of a table at one level; between tabulated levels it is the next higher entry, played softer.

    Raises TableError where the device has one zone.
    """
    names = [zone.name for zone in table.device.zones]
    if len(names) < 2:
        raise TableError(f"{table.path}: two fingers need two zones, {table.device.name} has one")
    cells = [[table.entry_for([felt], [quiet] if quiet != felt else [], level_db) for quiet in names] for felt in names]
    width, height = (_CELL_INCHES * len(names) + margin for margin in _MARGINS_INCHES)
    figure = Figure(figsize=(width, height), layout="constrained")
    _draw(figure, figure.add_subplot(), names, cells)
    caption = f"{table.device.name}: contrast of two fingers at {level_text(level_db)}"
    figure.suptitle(caption, fontsize="medium")
    draw_note(figure, table.device, FINGER_NOTE, THRESHOLD_NOTE)
    missed = sum(not entry.achieved for entry in itertools.chain(*cells))
    return Picture(
        figure,
        _columns(names, cells),
        {
            "device": table.device.name,
            "fingerprint": table.fingerprint,
            "wanted_level_db": finite(level_db),
            "zones": names,
            "expected_contrast_db": _contrasts(cells),
            "achieved": [[entry.achieved for entry in row] for row in cells],
            "estimated": [FINGER_NOTE, "detection threshold", *table.device.inferred],
        },
        f"{caption}: {_range_text(cells)}, level not achieved in {missed} of {len(names) ** 2} states",
    )


def _contrasts(cells: Cells) -> list[list[float | None]]:
    return [[entry.expected_contrast_db for entry in row] for row in cells]


def _range_text(cells: Cells) -> str:
    contrasts = [value for row in _contrasts(cells) for value in row if value is not None]
    return f"expected {min(contrasts):z.1f} to {max(contrasts):z.1f} dB"


def _draw(figure: Figure, axes: Axes, names: Sequence[str], cells: Cells) -> None:
    shown: NDArray[np.float64] = np.array(_contrasts(cells), dtype=np.float64)  # None becomes NaN
    middle = (np.nanmin(shown) + np.nanmax(shown)) / 2
    axes.set_facecolor(_SINGLE_CELL)
    image = axes.imshow(shown, cmap=COLOUR_MAP)
    figure.colorbar(image, label="expected contrast (dB)", shrink=0.8)
    for felt, quiet in itertools.product(range(len(names)), repeat=2):
        red, green, blue, _ = (float(part) for part in image.to_rgba(shown[felt, quiet]))
        ground = _SINGLE_CELL if felt == quiet else to_hex((red, green, blue))
        colour = "white" if shown[felt, quiet] < middle else "black"
        _draw_cell(axes, (felt, quiet), cells[felt][quiet], ground, colour)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="quiet finger in zone", ylabel="felt finger in zone")
    legend = "large: expected contrast (dB), small: standard and worst fingers\nΛ: localized factor of one finger alone"
    if not all(entry.achieved for row in cells for entry in row):
        legend += "\nhatched: level not reached, the greatest is given"
    axes.set_title(legend, fontsize="x-small")


def _draw_cell(axes: Axes, place: tuple[int, int], entry: Entry, ground: str, colour: str) -> None:
    felt, quiet = place
    if entry.contrast_db is None or entry.worst_case.contrast_db is None:
        large, small = f"Λ {entry.localized_factor:.2f}", f"worst {entry.worst_case.localized_factor:.2f}"
    else:
        large, small = (
            f"{entry.expected_contrast_db:z.1f}",
            f"{entry.contrast_db:z.1f} / {entry.worst_case.contrast_db:z.1f}",
        )
    if not entry.achieved:
        small += f"\n{entry.level_db:.1f} dB"
        axes.add_patch(Rectangle((quiet - 0.5, felt - 0.5), 1, 1, fill=False, hatch=_HATCH, ec=colour, lw=0, alpha=0.5))
    for shift, text, size in ((-0.08, large, "medium"), (0.18, small, "x-small")):
        axes.text(
            quiet,
            felt + shift,
            text,
            ha="center",
            va="bottom" if text == large else "center",
            color=colour,
            fontsize=size,
            bbox={"boxstyle": "square,pad=0.1", "fc": ground, "ec": "none"},
        )


def _columns(names: Sequence[str], cells: Cells) -> dict[str, Sequence[object]]:
    places = list(itertools.product(range(len(names)), repeat=2))
    entries = [cells[felt][quiet] for felt, quiet in places]
    return {
        "felt zone": [names[felt] for felt, _ in places],
        "quiet zone": ["" if felt == quiet else names[quiet] for felt, quiet in places],
        "expected contrast (dB)": [entry.expected_contrast_db for entry in entries],
        "standard contrast (dB)": [entry.contrast_db for entry in entries],
        "worst contrast (dB)": [entry.worst_case.contrast_db for entry in entries],
        "localized factor (1)": [entry.localized_factor for entry in entries],
        "level (dB above threshold)": [entry.level_db for entry in entries],
        "achieved (1)": [int(entry.achieved) for entry in entries],
    }
