"""Pictures of studies: what is left of contrast and factor in narrower zones, and of clicks on other bars."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from engine.device import Device
from precompute.studies.placement_search import Resolved
from precompute.studies.robustness import CLEAR_DB, FAINT_DB, FELT_DB, Change, Kept
from tactable.figures.picture_file import Picture
from tactable.figures.style import BLACK, BLUE, CURVES, GREY, ORANGE, finish_picture, percent_of, percents_text

TOLD_APART_DB = 10.0  # contrast that tells two fingers apart: a felt one at 20 dB, the quiet one at 10
_NAME_LETTERS = 28  # a line of the legend
_MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_resolution(device: Device, study: Sequence[Resolved], wanted_db: float) -> Picture:
    """Picture of a study; its placements in the order in which they come."""
    lines = [list(group) for _, group in itertools.groupby(study, key=lambda resolved: resolved.position_m)]
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for line, (colour, style), marker in zip(lines, itertools.cycle(CURVES), itertools.cycle(_MARKERS), strict=False):
        _draw_line(left, right, line, colour, style, marker, _name_of(device, line[0]))
    _finish(left, right, lines)
    handles, labels = left.get_legend_handles_labels()
    wrapped = [textwrap.fill(label, _NAME_LETTERS) for label in labels]
    figure.legend(handles, wrapped, fontsize="x-small", loc="outside right center")
    return finish_picture(
        figure,
        device,
        f"{device.name}: how narrow zones can be, every finger felt beside every other quiet, at {wanted_db:g} dB",
        "; ".join(_line_text(device, line) for line in lines),
        _columns(device, study),
        {
            "wanted_level_db": wanted_db,
            "told_apart_db": TOLD_APART_DB,
            "placements": [_summary_of(device, line) for line in lines],
        },
    )


def narrowest_zone_m(line: Sequence[Resolved]) -> float | None:
    """Width of the narrowest zones at which, and above which, every two fingers are told apart; None: at no width."""
    wide_first = sorted(line, key=lambda resolved: resolved.zones)
    kept = list(
        itertools.takewhile(lambda each: each.fingers.is_reached and each.fingers.worst_db >= TOLD_APART_DB, wide_first)
    )
    return kept[-1].zone_width_m if kept else None


def _draw_line(
    left: Axes, right: Axes, line: Sequence[Resolved], colour: str, style: str, marker: str, name: str
) -> None:
    width_mm = 1e3 * np.array([each.zone_width_m for each in line])
    worst_db = np.array([each.fingers.worst_db for each in line])
    missed = np.array([not each.fingers.is_reached for each in line])
    left.plot(width_mm, worst_db, marker=marker, color=colour, ls=style, lw=1.6, ms=6, label=name)
    left.plot(width_mm[missed], worst_db[missed], marker=marker, color="white", mec=colour, ls="", ms=6, zorder=4)
    factor = [float(each.factor.min()) for each in line]
    right.plot(width_mm, factor, marker=marker, color=colour, ls=style, lw=1.6, ms=6)


def _finish(left: Axes, right: Axes, lines: Sequence[Sequence[Resolved]]) -> None:
    left.axhline(TOLD_APART_DB, color=BLACK, lw=1.0, ls=(0, (1, 3)), label=f"told apart here: {TOLD_APART_DB:g} dB")
    if any(not each.fingers.is_reached for line in lines for each in line):
        left.plot([], [], "o", color="white", mec=GREY, label="hollow: a level out of reach")
    left.set(ylabel="worst contrast (dB)", ylim=(min(0.0, left.get_ylim()[0]), None))
    left.set_title("with fingers: worst of every felt and quiet zone", fontsize="small", loc="left")
    width_of = {each.zones: 1e3 * each.zone_width_m for line in lines for each in line}
    counts, width_mm = np.array(sorted(width_of)), np.array([width_of[count] for count in sorted(width_of)])
    right.plot(width_mm, 1 / counts, color=GREY, lw=1.0, ls=":", label="its share of the surface")
    right.set(ylabel="localized factor (1)", ylim=(0, 1.03))
    right.set_title("untouched: greatest factor of the worst zone alone", fontsize="small", loc="left")
    right.legend(fontsize="x-small", loc="upper left")
    for axes in (left, right):
        axes.set(xscale="log", xlabel="width of a zone, above it their number (mm)")
        axes.set_xticks(width_mm, [f"{at:.0f}" for at in width_mm])
        axes.minorticks_off()
        for at, count in zip(width_mm, counts, strict=True):
            axes.text(at, 0.01, str(count), fontsize="x-small", ha="center", transform=axes.get_xaxis_transform())
        axes.grid(alpha=0.25)


def _name_of(device: Device, resolved: Resolved) -> str:
    return f"{len(resolved.position_m)} at {percents_text(device, resolved.position_m)}"


def _line_text(device: Device, line: Sequence[Resolved]) -> str:
    narrowest_m = narrowest_zone_m(line)
    found = "not told apart" if narrowest_m is None else f"told apart to {1e3 * narrowest_m:.0f} mm"
    return f"{_name_of(device, line[0])} {found}"


def _columns(device: Device, study: Sequence[Resolved]) -> dict[str, list[object]]:
    return {
        "actuators (1)": [len(each.position_m) for each in study],
        "placement": [_name_of(device, each) for each in study],
        "zones (1)": [each.zones for each in study],
        "width of a zone (m)": [each.zone_width_m for each in study],
        "worst contrast (dB)": [each.fingers.worst_db for each in study],
        "median contrast (dB)": [float(np.nanmedian(each.fingers.contrast_db)) for each in study],
        "least level (dB above threshold)": [float(np.nanmin(each.fingers.level_db)) for each in study],
        "greatest localized factor of the worst zone (1)": [float(each.factor.min()) for each in study],
        "greatest localized factor of the best zone (1)": [float(each.factor.max()) for each in study],
    }


def _summary_of(device: Device, line: Sequence[Resolved]) -> dict[str, object]:
    return {
        "position_percent": [percent_of(device, at) for at in line[0].position_m],
        "narrowest_zone_m": narrowest_zone_m(line),
        "zones": [each.zones for each in line],
        "worst_contrast_db": [each.fingers.worst_db for each in line],
        "reached": [each.fingers.is_reached for each in line],
        "worst_factor": [float(each.factor.min()) for each in line],
    }


def plot_robustness(
    device: Device, changes: Sequence[Change], kept: Mapping[str, Sequence[Kept]], plants: int, placements: int
) -> Picture:
    """Picture of a study: what is kept (change,) by the spread that clicks are made for."""
    figure = Figure(figsize=(4.2 + 2.9 * len(kept), 1.9 + 0.27 * len(changes)), layout="constrained")
    panels = figure.subplots(1, len(kept), sharey=True, squeeze=False)[0]
    at = np.arange(len(changes))
    for axes, (name, rows) in zip(panels, kept.items(), strict=True):
        for key, most_db, colour in (("clear", CLEAR_DB, ORANGE), ("faint", FAINT_DB, BLUE)):
            label = f"felt ≥ {FELT_DB:g} dB, quiet ≤ {most_db:g} dB"
            axes.barh(at, [100 * getattr(row, key) for row in rows], 0.75, color=colour, label=label)
        axes.plot([100 * row.quiet for row in rows], at, "|", color=BLACK, ms=9, label=f"quiet ≤ {CLEAR_DB:g} dB alone")
        for y, row in zip(at.tolist(), rows, strict=True):
            axes.text(102, y, f"{row.low_contrast_db:z.1f}, {row.contrast_db:z.1f}", va="center", fontsize="x-small")
        axes.set(xlim=(0, 128), ylim=(len(changes) - 0.4, -0.6), xlabel="placements (%)", xticks=range(0, 101, 20))
        axes.set_title(f"clicks made for: {name}", fontsize="small", loc="left")
        axes.set_title("contrast (dB): 5 %, 50 %", fontsize="x-small", loc="right")
    panels[0].set_yticks(at, [change.name for change in changes], fontsize="small")
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize="x-small", loc="outside lower right", ncols=3)
    of = [(name, change.name, row) for name, rows in kept.items() for change, row in zip(changes, rows, strict=True)]
    found = [{"made_for": name, "different": change, **asdict(row)} for name, change, row in of]
    share = f"placements with felt >= {FELT_DB:g} dB and quiet <= {{:g}} dB (1)"
    headers = ["clicks made for", "what is different", share.format(FAINT_DB), share.format(CLEAR_DB)]
    headers += [
        f"placements with quiet <= {CLEAR_DB:g} dB (1)",
        "contrast, 5 % of the placements (dB)",
        "contrast, median (dB)",
    ]
    return finish_picture(
        figure,
        device,
        f"{device.name}: what clicks for two fingers keep, SIMULATED, where bar and fingers differ from the model",
        "; ".join(_words(name, rows) for name, rows in kept.items()),
        dict(zip(headers, zip(*(row.values() for row in found), strict=True), strict=True)),
        {"plants": plants, "placements": placements, "rows": found},
    )


def _words(name: str, rows: Sequence[Kept]) -> str:
    shares = [f"{100 * min(getattr(row, key) for row in rows):.0f} %" for key in ("faint", "clear")]
    return f"made for {name}: at least {shares[0]} keep quiet ≤ {FAINT_DB:g} dB, {shares[1]} ≤ {CLEAR_DB:g} dB"
