"""The map of contrasts: how much more one felt finger gets than one quiet finger, for every pair of zones."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from engine.table import Entry, Table
from tactable.figures.file import Picture
from tactable.figures.style import COLOUR_MAP, finish_picture, level_text
from tactable.figures.zone_map import (
    SINGLE_CELL,
    colour_of,
    draw_cell,
    label_zones,
    pair_columns,
    pair_entries,
    pairs_of,
    two_zone_names,
)

Cells = Sequence[Sequence[Entry]]
"""Entries by felt zone, then quiet zone; on the diagonal one felt finger alone."""

_CELL_INCHES = 1.0
_MARGINS_INCHES = (2.2, 1.9)
_HATCH = "//"


def plot_contrast_map(table: Table, level_db: float) -> Picture:
    """The map of a table at one level; between tabulated levels it is the next higher entry, played softer.

    Raises TableError where the device has one zone.
    """
    names = two_zone_names(table)
    cells = pair_entries(table, names, level_db)
    width, height = (_CELL_INCHES * len(names) + margin for margin in _MARGINS_INCHES)
    figure = Figure(figsize=(width, height), layout="constrained")
    _draw(figure, figure.add_subplot(), names, cells)
    missed = sum(not entry.achieved for row in cells for entry in row)
    return finish_picture(
        figure,
        table.device,
        f"{table.device.name}: contrast of two fingers at {level_text(level_db)}",
        f"{_range_text(cells)}, level not achieved in {missed} of {len(names) ** 2} states",
        _columns(names, cells),
        {
            "wanted_level_db": level_db,
            "zones": names,
            "expected_contrast_db": _contrasts(cells),
            "achieved": [[entry.achieved for entry in row] for row in cells],
        },
    )


def _contrasts(cells: Cells) -> list[list[float | None]]:
    return [[entry.expected_contrast_db for entry in row] for row in cells]


def _range_text(cells: Cells) -> str:
    contrasts = [value for row in _contrasts(cells) for value in row if value is not None]
    return f"expected {min(contrasts):z.1f} to {max(contrasts):z.1f} dB"


def _draw(figure: Figure, axes: Axes, names: Sequence[str], cells: Cells) -> None:
    shown: NDArray[np.float64] = np.array(_contrasts(cells), dtype=np.float64)  # None becomes NaN
    middle = (np.nanmin(shown) + np.nanmax(shown)) / 2
    axes.set_facecolor(SINGLE_CELL)
    image = axes.imshow(shown, cmap=COLOUR_MAP)
    figure.colorbar(image, label="expected contrast (dB)", shrink=0.8)
    for felt, quiet in pairs_of(names):
        ground = SINGLE_CELL if felt == quiet else colour_of(image, shown[felt, quiet])
        colour = "white" if shown[felt, quiet] < middle else "black"
        _draw_entry(axes, (felt, quiet), cells[felt][quiet], (ground, colour))
    label_zones(axes, names, quiet_label="quiet finger in zone", felt_label="felt finger in zone")
    legend = "large: expected contrast (dB), small: standard and worst fingers\nΛ: localized factor of one finger alone"
    if not all(entry.achieved for row in cells for entry in row):
        legend += "\nhatched: level not reached, the greatest is given"
    axes.set_title(legend, fontsize="x-small")


def _draw_entry(axes: Axes, pair: tuple[int, int], entry: Entry, paint: tuple[str, str]) -> None:
    worst = entry.worst_case
    if entry.contrast_db is None or worst.contrast_db is None:
        large, small = f"Λ {entry.localized_factor:.2f}", f"worst {worst.localized_factor:.2f}"
    else:
        large, small = f"{entry.expected_contrast_db:z.1f}", f"{entry.contrast_db:z.1f} / {worst.contrast_db:z.1f}"
    if not entry.achieved:
        small += f"\n{entry.level_db:.1f} dB"
    draw_cell(axes, pair, ((-0.08, large, "medium"), (0.18, small, "x-small")), paint, "" if entry.achieved else _HATCH)


def _columns(names: Sequence[str], cells: Cells) -> dict[str, Sequence[object]]:
    entries = [entry for row in cells for entry in row]
    return {
        **pair_columns(names),
        "expected contrast (dB)": [entry.expected_contrast_db for entry in entries],
        "standard contrast (dB)": [entry.contrast_db for entry in entries],
        "worst contrast (dB)": [entry.worst_case.contrast_db for entry in entries],
        "localized factor (1)": [entry.localized_factor for entry in entries],
        "level (dB above threshold)": [entry.level_db for entry in entries],
        "achieved (1)": [int(entry.achieved) for entry in entries],
    }
