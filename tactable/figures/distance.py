"""Clicks of two fingers anywhere on the bar against the distance between them: felt, quiet, and who keeps both."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from engine.device import Device
from engine.touch import ZoneState
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions
from precompute.studies.anywhere import AIM_FELT_DB, AIM_QUIET_DB, Anywhere, compare_anywhere
from tactable.figures.click import SPREAD_NOTE
from tactable.figures.file import Picture
from tactable.figures.style import BLACK, BLUE, FINGER_NOTE, GREY, STATE_COLOUR, THRESHOLD_NOTE, finish_picture

_WAYS = {"by_position": ("-", "made for the positions"), "by_zone": (":", "made for the middles of zones")}


def plot_distance(
    device: Device,
    distances_m: Sequence[float],
    wanted: Anywhere,
    workers: int,
    on_progress: Callable[[float], None],
    options: ClickOptions = DEFAULT_OPTIONS,
) -> Picture:
    """Picture of random placements whose fingers lie exactly so far apart; `wanted` says how many, and the seed."""
    found = list[dict[str, Any]]()
    for done, apart_m in enumerate(distances_m):
        asked = replace(wanted, apart_m=apart_m, is_exact=True)

        def tell(fraction: float, done: int = done) -> None:
            on_progress((done + fraction) / len(distances_m))

        found.append(compare_anywhere(device, asked, workers, tell, options)["summary"])
    distance_mm = 1e3 * np.array(distances_m)
    figure = Figure(figsize=(9, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for way, (line, name) in _WAYS.items():
        _draw_levels(left, distance_mm, [summary[way] for summary in found], line, name)
        share = [100 * summary[way]["share_that_keeps_the_aim"] for summary in found]
        right.plot(distance_mm, share, f"o{line}", color=BLUE if way == "by_position" else BLACK, label=name)
    left.axhline(0.0, color=GREY, lw=1.2, ls="--")
    left.set(xlabel="distance between the fingers (mm)", ylabel="level (dB above threshold)")
    left.set_title("5 to 95 % of the placements, and the middle", fontsize="small", loc="left")
    right.set(xlabel="distance between the fingers (mm)", ylabel="placements (%)", ylim=(-2, 102))
    kept = f"felt ≥ {AIM_FELT_DB:g} dB (5 %) and quiet ≤ {AIM_QUIET_DB:g} dB (95 %)"
    right.set_title(kept, fontsize="small", loc="left")
    for axes in (left, right):
        axes.grid(alpha=0.25)
        axes.legend(fontsize="x-small")
    plants = f"{wanted.plants} fresh plants, fingers within {1e3 * wanted.tolerance_m:g} mm"
    return finish_picture(
        figure,
        device,
        f"{device.name}: two fingers anywhere, one felt",
        "; ".join(
            f"{mm:g} mm: felt {summary['by_position']['felt_db'][1]:.1f} dB"
            for mm, summary in zip(distance_mm, found, strict=True)
        ),
        _columns(distance_mm.tolist(), found),
        {"placements": wanted.placements, "seed": wanted.seed, "plants": wanted.plants},
        notes=(FINGER_NOTE, SPREAD_NOTE, THRESHOLD_NOTE),
        subtitle=f"{wanted.placements} random placements for each distance; {plants}; SIMULATED",
    )


def _draw_levels(axes: Axes, distance_mm: Any, figures: Sequence[dict[str, Any]], line: str, name: str) -> None:
    for key, kind, percent in (("felt_db", ZoneState.FELT, 5), ("quiet_db", ZoneState.QUIET, 95)):
        low, middle, high = np.array([figure[key] for figure in figures]).T
        colour = STATE_COLOUR[kind]
        if line == "-":
            axes.fill_between(distance_mm, low, high, color=colour, alpha=0.18, lw=0)
        axes.plot(
            distance_mm, middle, f"o{line}", color=colour, ms=4, label=f"{kind.name.lower()} ({percent} %), {name}"
        )


def _columns(distance_mm: Sequence[float], found: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    columns: dict[str, list[float]] = {"distance (mm)": list(distance_mm)}
    for way, (_, name) in _WAYS.items():
        for key, label in (("felt_db", "felt level, 5 %"), ("quiet_db", "quiet level, 95 %")):
            for index, percent in enumerate((5, 50, 95)):
                header = f"{label} of the plants, {percent} % of the placements, {name} (dB above threshold)"
                columns[header] = [summary[way][key][index] for summary in found]
        columns[f"share that keeps both, {name} (1)"] = [summary[way]["share_that_keeps_the_aim"] for summary in found]
    return columns
