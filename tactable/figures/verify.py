"""What a table promises at the sensor against what it read, a panel for steady drives and one for clicks."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tactable.figures.file import Picture
from tactable.figures.style import BLACK, BLUE, VERMILLION

Array = NDArray[np.float64]


def plot_verification(
    title: str,
    kind: Sequence[str],
    read: Array,
    promised: Array,
    low: Array,
    high: Array,
    is_outside: NDArray[np.bool_],
) -> Picture:
    """Readings (point,) over the promised peaks with their intervals, m/s^2; kind (point,): "drive" or "click"."""
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
        for outside, colour, label in ((False, BLACK, "within"), (True, VERMILLION, "outside")):
            points = chosen & (is_outside == outside)
            panel.plot(promised[points], read[points], ".", color=colour, label=label)
        panel.legend(fontsize="x-small")
    figure.suptitle(title, fontsize="medium")
    columns = {
        "kind": list(kind),
        "promised (m/s^2)": promised,
        "low (m/s^2)": low,
        "high (m/s^2)": high,
        "read (m/s^2)": read,
        "outside": is_outside.astype(int).tolist(),
    }
    return Picture(figure, columns, {"points": len(read), "outside": int(is_outside.sum())}, title)
