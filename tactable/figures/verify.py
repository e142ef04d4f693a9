"""What a table promises at the sensor against what it read, a panel for steady drives and one for clicks."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tactable.figures.file import Picture
from tactable.figures.style import BLACK, BLUE, GREY, ORANGE, VERMILLION

Array = NDArray[np.float64]
_COLOURS = {"kept": BLACK, "broken": VERMILLION, "not shown": ORANGE, "spoiled": GREY}


def plot_verification(
    title: str,
    kind: Sequence[str],
    read: Array,
    promised: Array,
    low: Array,
    high: Array,
    error: Array,
    outcome: Sequence[str],
) -> Picture:
    """Readings (point,) and their errors over the promised peaks with their intervals, m/s^2.

    kind (point,): "drive" or "click". outcome (point,): as `tactable.measure.verify.Outcome` names them.
    """
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    for panel, name in zip(figure.subplots(1, 2), ("drive", "click"), strict=True):
        chosen = np.array([each == name for each in kind], dtype=bool)
        panel.set(xscale="log", yscale="log", xlabel="promised, m/s²", ylabel="read, m/s²", title=f"{name}s")
        if not chosen.any():
            panel.set_visible(False)
            continue
        ends = np.array([promised[chosen].min(), promised[chosen].max()])
        panel.plot(ends, ends, color=BLACK, lw=0.8)
        least = 0.5 * read[chosen].min()
        panel.vlines(promised[chosen], np.maximum(low[chosen], least), high[chosen], color=BLUE, alpha=0.5)
        for named, colour in _COLOURS.items():
            points = chosen & np.array([each == named for each in outcome], dtype=bool)
            off = np.minimum(error[points], 0.999 * read[points]), error[points]  # down to a place on the axis
            panel.errorbar(promised[points], read[points], off, fmt=".", color=colour, label=named, elinewidth=0.6)
        panel.legend(fontsize="x-small")
    figure.suptitle(title, fontsize="medium")
    columns: dict[str, Sequence[str] | Array] = {
        "kind": list(kind),
        "promised (m/s^2)": promised,
        "low (m/s^2)": low,
        "high (m/s^2)": high,
        "read (m/s^2)": read,
        "error (m/s^2)": error,
        "outcome": list(outcome),
    }
    return Picture(figure, columns, {"points": len(read), "broken": [*outcome].count("broken")}, title)
