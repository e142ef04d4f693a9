"""The map of clicks of two fingers: what the felt one gets and the quiet one keeps below, beside a gated drive."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from engine.table import ClickEntry
from engine.touch import Placement
from precompute.clicks import Click
from precompute.clicks.baselines import GATED_DRIVE
from tactable.explain.click_source import ClickSource
from tactable.figures.click import SPREAD_NOTE
from tactable.figures.file import Picture
from tactable.figures.style import COLOUR_MAP, FINGER_NOTE, THRESHOLD_NOTE, finish_picture
from tactable.figures.zone_map import (
    SINGLE_CELL,
    colour_of,
    draw_cell,
    label_zones,
    pair_columns,
    pairs_of,
    two_zone_names,
)

_CELL_INCHES = 0.9
_MARGINS_INCHES = (2.6, 2.0)
_HATCH = "//"


@dataclass(frozen=True, eq=False)
class Cell:
    """Two fingers: their click, and the best steady drive gated for as long; on the diagonal one felt finger alone."""

    click: ClickEntry
    gated: Click
    is_tabulated: bool

    @property
    def shown(self) -> tuple["Shown", "Shown"]:
        """What is shown of the click, then of the gated drive."""
        quiet, gated_quiet = self.click.quiet, self.gated.evaluation.quiet
        return (
            Shown(self.click.felt.low_db, None if quiet is None else quiet.high_db, self.click.achieved),
            Shown(self.gated.evaluation.felt.low_db, None if gated_quiet is None else gated_quiet.high_db, True),
        )


@dataclass(frozen=True)
class Shown:
    """What a cell says, dB above threshold: 5 % of the plants are below felt_db, 5 % above quiet_db."""

    felt_db: float
    quiet_db: float | None
    achieved: bool


Cells = Sequence[Sequence[Cell]]
"""Cells by felt zone, then quiet zone."""


def plot_click_map(source: ClickSource, on_progress: Callable[[float], None]) -> Picture:
    """The map of one felt and one quiet finger in the middles of their zones, as strong as clicks are.

    Clicks that the table does not have are solved; `on_progress` gets the fraction done. Raises TableError where the
    device has one zone.
    """
    table = source.table
    names = two_zone_names(table)
    cells = _solve_cells(source, names, on_progress)
    width, height = (_CELL_INCHES * count * len(names) for count in (2, 1))
    figure = Figure(figsize=(width + _MARGINS_INCHES[0], height + _MARGINS_INCHES[1]), layout="constrained")
    _draw(figure, names, cells)
    pairs = [cell for row in cells for cell in row if cell.click.quiet is not None]
    return finish_picture(
        figure,
        table.device,
        f"{table.device.name}: clicks of two fingers",
        _range_text(pairs),
        _columns(names, cells),
        _summary(source, names, cells),
        notes=(FINGER_NOTE, SPREAD_NOTE, THRESHOLD_NOTE),
        subtitle="large: felt level (dB), 5 % of fresh plants are below; small: quiet level, 5 % above",
    )


def _solve_cells(source: ClickSource, names: Sequence[str], on_progress: Callable[[float], None]) -> Cells:
    """Fingers in the middles of zones; pairs with the same fingers one after another share what is computed."""
    pairs = sorted(pairs_of(names), key=lambda pair: (max(pair), min(pair)))
    solved = dict[tuple[int, int], Cell]()
    for felt, quiet in pairs:
        placement = Placement.named(source.table.device, [names[felt]], [names[quiet]] if quiet != felt else [])
        click = source.click_of(placement)
        gated = source.solve_baseline(placement, GATED_DRIVE, click.length_s)
        solved[felt, quiet] = Cell(click, gated, source.holds(placement))
        on_progress(len(solved) / len(pairs))
    return [[solved[felt, quiet] for quiet in range(len(names))] for felt in range(len(names))]


def _range_text(pairs: Sequence[Cell]) -> str:
    felt, gated = ([shown.felt_db for shown in column] for column in zip(*(cell.shown for cell in pairs), strict=True))
    quiet_db = max(cell.click.quiet.high_db for cell in pairs if cell.click.quiet is not None)
    return (
        f"felt {min(felt):z.1f} to {max(felt):z.1f} dB, quiet at most {quiet_db:z.1f} dB; "
        f"steady drives gated as long {min(gated):z.1f} to {max(gated):z.1f} dB"
    )


def _draw(figure: Figure, names: Sequence[str], cells: Cells) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    levels = np.array([[[shown.felt_db for shown in cell.shown] for cell in row] for row in cells])
    levels[np.eye(len(names), dtype=bool)] = np.nan
    ends = float(np.nanmin(levels)), float(np.nanmax(levels))
    for k, (axes, title) in enumerate(((left, "click"), (right, f"{GATED_DRIVE}, as long"))):
        image = axes.imshow(levels[..., k], cmap=COLOUR_MAP, vmin=ends[0], vmax=ends[1])
        axes.set_facecolor(SINGLE_CELL)
        for felt, quiet in pairs_of(names):
            shown = cells[felt][quiet].shown[k]
            _draw_shown(axes, (felt, quiet), shown, _paint(shown, image, sum(ends) / 2))
        axes.set_title(title, fontsize="medium")
        felt_label = "felt finger in zone" if axes is left else None
        label_zones(axes, names, quiet_label="quiet finger in zone (grey: none)", felt_label=felt_label)
    figure.colorbar(image, ax=[left, right], label="felt level (dB above threshold)", shrink=0.85)


def _paint(shown: Shown, image: AxesImage, middle_db: float) -> tuple[str, str]:
    """Colours of a cell's ground and of what is written on it."""
    if shown.quiet_db is None:
        return SINGLE_CELL, "black"
    return colour_of(image, shown.felt_db), "white" if shown.felt_db < middle_db else "black"


def _draw_shown(axes: Axes, pair: tuple[int, int], shown: Shown, paint: tuple[str, str]) -> None:
    small = "alone" if shown.quiet_db is None else f"{shown.quiet_db:z.1f}"
    if not shown.achieved:
        small += "\nnot achieved"
    texts = ((-0.05, f"{shown.felt_db:z.1f}", "medium"), (0.2, small, "x-small"))
    draw_cell(axes, pair, texts, paint, "" if shown.achieved else _HATCH)


def _columns(names: Sequence[str], cells: Cells) -> dict[str, Sequence[object]]:
    columns, flat = pair_columns(names), [cell for row in cells for cell in row]
    for k, name in enumerate(("click", GATED_DRIVE)):
        columns[f"felt level of the {name}, 5 % (dB above threshold)"] = [cell.shown[k].felt_db for cell in flat]
        columns[f"quiet level of the {name}, 95 % (dB above threshold)"] = [cell.shown[k].quiet_db for cell in flat]
    columns["upper bound of the click (dB above threshold)"] = [cell.click.bound_db for cell in flat]
    columns["length (s)"] = [cell.click.length_s for cell in flat]
    columns["achieved (1)"] = [int(cell.click.achieved) for cell in flat]
    columns["in the table (1)"] = [int(cell.is_tabulated) for cell in flat]
    return columns


def _summary(source: ClickSource, names: Sequence[str], cells: Cells) -> dict[str, object]:
    def matrix(value: Callable[[Cell], float | bool | None]) -> NDArray[np.object_]:
        return np.array([[value(cell) for cell in row] for row in cells], dtype=np.object_)

    return {
        "zones": list(names),
        "felt_level_db": matrix(lambda cell: cell.shown[0].felt_db),
        "quiet_level_db": matrix(lambda cell: cell.shown[0].quiet_db),
        "gated_felt_level_db": matrix(lambda cell: cell.shown[1].felt_db),
        "gated_quiet_level_db": matrix(lambda cell: cell.shown[1].quiet_db),
        "achieved": matrix(lambda cell: cell.click.achieved),
        "is_tabulated": matrix(lambda cell: cell.is_tabulated),
        "plants": source.options.judged,
    }
