"""What clicks keep on bars and fingers that differ from the model: shares of placements, one panel a set of spreads."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from matplotlib.figure import Figure

from engine.device import Device
from precompute.studies.robustness import CLEAR_DB, FAINT_DB, FELT_DB, Change, Kept
from tactable.figures.picture_file import Picture
from tactable.figures.style import BLACK, BLUE, ORANGE, finish_picture


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
