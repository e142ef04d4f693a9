"""A study of one click: its levels against its length, and against the number of plants it is optimised over."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.plain import to_plain
from precompute.clicks import Click
from precompute.clicks.evaluation import Levels
from tactable.explain.click_study import Study
from tactable.explain.words import placement_json, placement_text, zone_lists
from tactable.figures.click import SPREAD_NOTE
from tactable.figures.file import Picture
from tactable.figures.style import (
    BLACK,
    FINGER_NOTE,
    GREY,
    ROLE_COLOUR,
    THRESHOLD_NOTE,
    Array,
    finish_picture,
)

_MARKERS = {True: "o", False: "s"}
"""Markers by whether the finger is to feel."""


def plot_click_study(study: Study) -> Picture:
    """Picture of a study."""
    device, options = study.device, study.options
    figure = Figure(figsize=(9, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw(left, 1e3 * np.array(list(study.by_length)), list(study.by_length.values()))
    left.set(xlabel="length of the click (ms)", ylabel="level (dB above threshold)")
    left.set_title(f"optimised over {options.scenarios} plants", fontsize="small", loc="left")
    _draw(right, np.array(list(study.by_scenarios), dtype=np.float64), list(study.by_scenarios.values()))
    right.set_xscale("log", base=2)
    right.set_xticks(list(study.by_scenarios), [str(count) for count in study.by_scenarios])
    right.set(xlabel="plants that it is optimised over")
    right.set_title(f"{1e3 * options.lengths_s[0]:g} ms long", fontsize="small", loc="left")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize="x-small", loc="outside right upper")
    return finish_picture(
        figure,
        device,
        f"{device.name}: {placement_text(device, study.placement)}, what a click gains",
        _range_text(study),
        _columns(study),
        _summary(study),
        notes=(FINGER_NOTE, SPREAD_NOTE, THRESHOLD_NOTE),
        subtitle=f"judged on {options.judged} fresh plants, the same everywhere",
    )


def _draw(axes: Axes, place: Array, clicks: Sequence[Click]) -> None:
    sides = {True: [click.evaluation.felt for click in clicks], False: _quiet(clicks)}
    for is_felt, levels in sides.items():
        if levels:
            _draw_levels(axes, place, levels, is_felt=is_felt)
    bounds_db = np.array([click.bound_db for click in clicks])
    known = np.isfinite(bounds_db)
    bound = "no click of its tones\nis felt more strongly\n(mean of the plants\noptimised over)"
    axes.plot(place[known], bounds_db[known], "_:", color=BLACK, ms=10, lw=1.0, label=bound)
    axes.axhline(0.0, color=GREY, lw=1.2, ls="--", label="detection threshold\n(ESTIMATE)")
    axes.grid(alpha=0.25)


def _draw_levels(axes: Axes, place: Array, levels: Sequence[Levels], *, is_felt: bool) -> None:
    low, middle, high = (
        np.array([getattr(level, key) for level in levels]) for key in ("low_db", "middle_db", "high_db")
    )
    colour, name = ROLE_COLOUR[is_felt], "felt" if is_felt else "quiet"
    promised, percent = (low, 5) if is_felt else (high, 95)
    axes.fill_between(place, low, high, color=colour, alpha=0.2, lw=0, label=f"{name}, 5 to 95 %")
    axes.plot(place, middle, color=colour, lw=1.0, ls="--", label=f"{name}, 50 %")
    axes.plot(place, promised, _MARKERS[is_felt], ls="-", color=colour, lw=1.8, ms=5, label=f"{name}, {percent} %")


def _quiet(clicks: Sequence[Click]) -> list[Levels]:
    return [click.evaluation.quiet for click in clicks if click.evaluation.quiet is not None]


def _range_text(study: Study) -> str:
    def felt(clicks: Sequence[Click]) -> str:
        return f"felt {clicks[0].evaluation.felt.low_db:z.1f} to {clicks[-1].evaluation.felt.low_db:z.1f} dB"

    lengths, counts = list(study.by_length), list(study.by_scenarios)
    return (
        f"{felt(list(study.by_length.values()))} from {1e3 * lengths[0]:g} to {1e3 * lengths[-1]:g} ms, "
        f"{felt(list(study.by_scenarios.values()))} from {counts[0]} to {counts[-1]} plants"
    )


def _columns(study: Study) -> dict[str, Sequence[object]]:
    clicks = [click for *_, click in study.clicks]
    columns: dict[str, Sequence[object]] = {
        "varied": [varied for varied, *_ in study.clicks],
        "length (s)": [length_s for _, length_s, *_ in study.clicks],
        "scenarios (1)": [count for *_, count, _ in study.clicks],
    }
    for key, percent in (("low_db", 5), ("middle_db", 50), ("high_db", 95)):
        quiet = [click.evaluation.quiet for click in clicks]
        columns[f"felt level, {percent} % (dB above threshold)"] = [getattr(c.evaluation.felt, key) for c in clicks]
        columns[f"quiet level, {percent} % (dB above threshold)"] = [q and getattr(q, key) for q in quiet]
    columns["upper bound (dB above threshold)"] = to_plain([click.bound_db for click in clicks])
    columns["achieved (1)"] = [int(click.achieved) for click in clicks]
    return columns


def _summary(study: Study) -> dict[str, object]:
    return {
        **zone_lists(study.device, study.placement.zone_states(study.device)),
        "fingers": placement_json(study.device, study.placement),
        "judged": study.options.judged,
        "clicks": [
            {
                "varied": varied,
                "length_s": length_s,
                "scenarios": count,
                "level_db": click.evaluation.felt.low_db,
                "quiet_level_db": None if click.evaluation.quiet is None else click.evaluation.quiet.high_db,
                "upper_bound_db": click.bound_db,
                "achieved": click.achieved,
            }
            for varied, length_s, count, click in study.clicks
        ],
    }
