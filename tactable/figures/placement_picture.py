"""Searches for places of actuators: the best layouts found, and the contrast of every layout that was tried."""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Rectangle

from base.points import sides_of
from engine.device import Device
from precompute.studies.placement_search import Placement, PlacementSearch
from tactable.figures import style
from tactable.figures.picture_file import Picture

SIZE_NOTE = "size of an actuator"
_ROW_INCHES, _REST_INCHES = 0.34, 5.0  # a line of text each; title, axes and the map
_PLATES_A_ROW, _PLATE_INCHES = 3, 2.3
_COLOUR = {"found": style.BLUE, "as described": style.VERMILLION, "even": style.GREY}
_MARK = {"found": "^", "as described": "s", "even": "o"}


def plot_placement(device: Device, searches: Sequence[PlacementSearch], wanted_db: float) -> Picture:
    """Picture of searches for one or more numbers of actuators."""
    rows = [(search, placement) for search in searches for placement in search.evaluated]
    is_plate = style.is_plate(device)
    with_map = None if is_plate else next((search for search in searches if search.count == 2), None)
    inches = _PLATE_INCHES * math.ceil(len(rows) / _PLATES_A_ROW) if is_plate else _ROW_INCHES * len(rows)
    figure = Figure(figsize=(9.6, _REST_INCHES + inches), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[inches + 0.9, 3.6], squeeze=False)[:, 0]
    if is_plate:
        _draw_plates(above, device, rows)
    else:
        _draw_layouts(above.subplots(), device, rows)
    panels = below.subplots(1, 2 if with_map else 1, squeeze=False)[0]
    if with_map is not None:
        _draw_map(below, panels[0], with_map)
    _draw_distribution(panels[-1], searches)
    return style.finish_picture(
        figure,
        device,
        f"{device.name}: where actuators go for the best worst contrast of two fingers at {wanted_db:g} dB",
        "; ".join(_search_text(device, search) for search in searches),
        _columns(searches),
        {"wanted_level_db": wanted_db, "searches": [_summary_of(device, search) for search in searches]},
        notes=(style.FINGER_NOTE, style.THRESHOLD_NOTE, SIZE_NOTE),
    )


def _draw_layouts(axes: Axes, device: Device, rows: Sequence[tuple[PlacementSearch, Placement]]) -> None:
    """A line a placement, the actuators on it, what it gives beside it."""
    length_mm = 1e3 * device.bar.length_m
    for k, (search, placement) in enumerate(rows):
        axes.plot([0, length_mm], [k, k], color=style.GREY, lw=2.5, solid_capstyle="butt", zorder=1)
        place_mm, size = 1e3 * np.array(placement.position_m), 9 if placement.name == "found" else 7
        mark, colour = _MARK[placement.name], _COLOUR[placement.name]
        axes.plot(place_mm, [k] * len(place_mm), mark, ms=size, color=colour, zorder=2)
        is_new = k == 0 or rows[k - 1][0] is not search
        if is_new and k > 0:
            axes.axhline(k - 0.5, color=style.GREY, lw=0.5)
        axes.text(1.01 * length_mm, k, _placement_text(device, placement), va="center", fontsize="small")
    for zone in device.zones:
        axes.text(1e3 * zone.middle_m.real, -0.75, zone.name, ha="center", fontsize="small")
    style.draw_zone_edges(axes, device, ":")
    axes.set_yticks(range(len(rows)), [f"{search.count}, {placement.name}" for search, placement in rows])
    axes.set(xlim=(0, length_mm), ylim=(len(rows) - 0.4, -1.1), xlabel="along the bar (mm)")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _draw_plates(figure: SubFigure, device: Device, rows: Sequence[tuple[PlacementSearch, Placement]]) -> None:
    """A plate from above for each placement, with its zones, the actuators on it, and what it gives."""
    all_axes = figure.subplots(math.ceil(len(rows) / _PLATES_A_ROW), _PLATES_A_ROW, squeeze=False).ravel()
    corner_mm = 1e3 * device.surface.corner_m
    figure.supxlabel("along the plate (mm), and across it", fontsize="small")
    for axes in all_axes[len(rows) :]:
        axes.set_axis_off()
    for axes, (search, placement) in zip(all_axes, rows, strict=False):
        for zone in device.zones:
            start_mm, size_mm = 1e3 * zone.start_m, 1e3 * (zone.stop_m - zone.start_m)
            outline = (start_mm.real, start_mm.imag), size_mm.real, size_mm.imag
            axes.add_patch(Rectangle(*outline, fill=False, ec=style.GREY, lw=0.5))
        at_mm = 1e3 * np.array(placement.position_m)
        axes.plot(at_mm.real, at_mm.imag, _MARK[placement.name], ms=7, color=_COLOUR[placement.name])
        what = _placement_text(device, placement).replace(", median", ",\nmedian")
        axes.set_title(f"{search.count}, {placement.name}: {what}", fontsize="x-small", loc="left")
        axes.tick_params(labelsize="x-small")
        axes.set(xlim=(0, corner_mm.real), ylim=(0, corner_mm.imag), aspect="equal")


def _draw_map(figure: SubFigure, axes: Axes, search: PlacementSearch) -> None:
    """Draw the worst contrast over the positions of two actuators."""
    place_m = np.unique(search.screened_m)
    shown = np.full((len(place_m), len(place_m)), np.nan)
    first, second = (np.searchsorted(place_m, search.screened_m[:, i]) for i in (0, 1))
    shown[second, first] = search.screened_db
    axes.set_facecolor("0.92")
    step_m = place_m[1] - place_m[0]
    ends_mm = 1e3 * (place_m[0] - step_m / 2), 1e3 * (place_m[-1] + step_m / 2)
    image = axes.imshow(shown, origin="lower", extent=(*ends_mm, *ends_mm), cmap=style.COLOUR_MAP, aspect="auto")
    for placement in search.evaluated:
        name, (left_mm, right_mm) = placement.name, 1e3 * np.array(placement.position_m)
        axes.plot(left_mm, right_mm, _MARK[name], ms=9, mew=1.2, mec="white", color=_COLOUR[name], label=name)
    axes.set(xlabel="left of two actuators (mm)", ylabel="right of two actuators (mm)")
    axes.set_title("two actuators; grey: a level out of reach, or not looked at", fontsize="small", loc="left")
    axes.legend(fontsize="x-small", loc="lower right")
    figure.colorbar(image, ax=axes, label="worst contrast, screened (dB)")


def _draw_distribution(axes: Axes, searches: Sequence[PlacementSearch]) -> None:
    """Draw, for each number of actuators, what share of the placements reaches a worst contrast; a star: the best."""
    for search, (colour, ls) in zip(searches, itertools.cycle(style.CURVES), strict=False):
        reached = np.sort(search.screened_db[np.isfinite(search.screened_db)])[::-1]
        share = 100 * np.arange(1, len(reached) + 1) / len(search.screened_db)
        axes.step(reached, share, where="post", color=colour, ls=ls, lw=1.7, label=f"{search.count} actuators")
        best_db = search.evaluated[0].fingers.worst_db
        axes.plot(best_db, 0, "*", ms=12, color=colour, mec=style.BLACK, mew=0.5, clip_on=False, zorder=4)
    axes.plot([], [], "*", ms=10, color="white", mec=style.BLACK, label="the best, judged")
    axes.set(xlabel="worst contrast (dB)", ylabel="placements of the grid\nthat reach it (%)", ylim=(0, 100))
    axes.grid(alpha=0.25)
    axes.legend(fontsize="x-small", loc="upper right")


def _placement_text(device: Device, placement: Placement) -> str:
    fingers, names = placement.fingers, [zone.name for zone in device.zones]
    if not fingers.is_reached:
        return f"a level out of reach: {np.nanmin(fingers.level_db):.1f} dB at most"
    felt, quiet = np.unravel_index(np.nanargmin(fingers.contrast_db), fingers.contrast_db.shape)
    return (
        f"worst {fingers.worst_db:z.1f} dB ({names[int(felt)]} felt, {names[int(quiet)]} quiet), "
        f"median {np.nanmedian(fingers.contrast_db):z.1f} dB"
    )


def _search_text(device: Device, search: PlacementSearch) -> str:
    return f"{search.count} actuators: " + ", ".join(
        f"{placement.name} at {style.percents_text(device, placement.position_m)} {_value_text(placement)}"
        for placement in search.evaluated
    )


def _value_text(placement: Placement) -> str:
    fingers = placement.fingers
    return f"{fingers.worst_db:z.1f} dB" if fingers.is_reached else "out of reach"


def _columns(searches: Sequence[PlacementSearch]) -> dict[str, list[object]]:
    """A row a placement: those judged, then those screened, of one number of actuators after another."""
    most = max(search.count for search in searches)
    axes = ("", " across") if np.iscomplexobj(searches[0].screened_m) else ("",)
    places = [f"position {i + 1}{axis} (m)" for i in range(most) for axis in axes]
    figures = ["worst contrast (dB)", "median contrast (dB)", "least level (dB above threshold)"]
    rows = [
        [search.count, name, *sides, *[None] * (len(places) - len(sides)), *values]
        for search in searches
        for name, at, values in _rows_of(search)
        for sides in [[side_m for at_m in at for side_m in sides_of(at_m)[: len(axes)]]]
    ]
    headers = ["actuators (1)", "placement", *places, *figures]
    return {header: list(column) for header, column in zip(headers, zip(*rows, strict=True), strict=True)}


def _rows_of(search: PlacementSearch) -> Iterator[tuple[str, Sequence[complex], tuple[float | None, ...]]]:
    """Name, positions, and worst and median contrast and least level of every placement."""
    for placement in search.evaluated:
        fingers = placement.fingers
        worst_db = fingers.worst_db if fingers.is_reached else None
        median_db, least_db = float(np.nanmedian(fingers.contrast_db)), float(np.nanmin(fingers.level_db))
        yield placement.name, placement.position_m, (worst_db, median_db, least_db)
    for at, value in zip(search.screened_m.tolist(), search.screened_db.tolist(), strict=True):
        yield "screened", at, (value, None, None)


def _summary_of(device: Device, search: PlacementSearch) -> dict[str, object]:
    return {
        "actuators": search.count,
        "screened": len(search.screened_db),
        "moved": search.moved,
        "judged": [
            {
                "placement": placement.name,
                "position_percent": [style.percent_of(device, at) for at in placement.position_m],
                "reached": placement.fingers.is_reached,
                "worst_contrast_db": placement.fingers.worst_db,
                "median_contrast_db": float(np.nanmedian(placement.fingers.contrast_db)),
                "contrast_db": placement.fingers.contrast_db,
            }
            for placement in search.evaluated
        ],
    }
