"""The frame of the maps of two fingers: a row for each felt zone, a column for each quiet zone, text in every cell.

On the diagonal one felt finger is alone. Several figures share it; each of them decides what its cells say.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

from engine.table import Table, TableError

SINGLE_CELL = "0.92"
"""Ground of a cell without a value."""


def pairs_of(names: Sequence[str]) -> list[tuple[int, int]]:
    """Felt and quiet zone of every cell, row by row."""
    return [(felt, quiet) for felt in range(len(names)) for quiet in range(len(names))]


def two_zone_names(table: Table) -> list[str]:
    """Names of the zones. Raises TableError where the device has one zone."""
    names = [zone.name for zone in table.device.zones]
    if len(names) < 2:
        raise TableError(f"{table.path}: two fingers need two zones, {table.device.name} has one")
    return names


def pair_columns(names: Sequence[str]) -> dict[str, Sequence[object]]:
    """The columns of the data that name the zones of each cell."""
    pairs = pairs_of(names)
    quiet_names = ["" if felt == quiet else names[quiet] for felt, quiet in pairs]
    return {"felt zone": [names[felt] for felt, _ in pairs], "quiet zone": quiet_names}


def label_zones(axes: Axes, names: Sequence[str], *, quiet_label: str, felt_label: str | None) -> None:
    """Names of the zones on both axes."""
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel(quiet_label)
    if felt_label is not None:
        axes.set_ylabel(felt_label)


def colour_of(image: ScalarMappable, value: float) -> str:
    """The colour of a value in the image, to be the ground of text."""
    red, green, blue, _ = (float(part) for part in image.to_rgba(np.array(value)))
    return to_hex((red, green, blue))


def draw_cell(
    axes: Axes, pair: tuple[int, int], texts: Sequence[tuple[float, str, str]], paint: tuple[str, str], hatch: str = ""
) -> None:
    """Write texts (shift down, text, size) on a cell in `paint` (ground, colour of the text), under its hatch."""
    (felt, quiet), (ground, colour) = pair, paint
    if hatch:
        axes.add_patch(Rectangle((quiet - 0.5, felt - 0.5), 1, 1, fill=False, hatch=hatch, ec=colour, lw=0, alpha=0.5))
    for shift, text, size in texts:
        box = {"boxstyle": "square,pad=0.1", "fc": ground, "ec": "none"}
        vertical = "bottom" if shift < 0 else "center"
        axes.text(quiet, felt + shift, text, ha="center", va=vertical, color=colour, fontsize=size, bbox=box)
