"""The first modes of a bar: their shapes, untouched and with fingers, and how fast each dies away."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from engine.device import Device
from precompute.model.modes import Mode
from tactable.figures.file import Picture
from tactable.figures.style import BLUE, FINGER_NOTE, VERMILLION, Array, draw_actuators, draw_zone_names, finish_picture

_MOST_PANELS = 8


def plot_modes(
    device: Device, position_m: Array, finger_m: Sequence[float], untouched: Sequence[Mode], touched: Sequence[Mode]
) -> Picture:
    """Picture of up to eight modes, a panel each; both sets are numbered by their frequencies."""
    count = max(1, min(_MOST_PANELS, len(untouched)))
    figure = Figure(figsize=(9, 1.6 + 1.3 * count), layout="constrained")
    panels = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    sets = (("untouched", BLUE, "-", untouched), ("with finger", VERMILLION, "--", touched))
    for k, axes in enumerate(panels):
        for name, colour, ls, modes in sets:
            if k < len(modes):
                label = f"{name}: {modes[k].frequency_hz:.1f} Hz, {100 * modes[k].damping_ratio:.2g} %"
                axes.plot(1e3 * position_m, modes[k].shape, ls, color=colour, label=label)
        for at_m in finger_m:
            axes.plot(1e3 * at_m, 0.0, "v", color=VERMILLION, ms=7)
        axes.axhline(0.0, color="grey", lw=0.5)
        axes.set(ylim=(-1.3, 1.3), yticks=[], ylabel=f"{k + 1}")
        axes.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        if k == 0:
            draw_zone_names(axes, device)
    draw_actuators(panels[-1], device)
    panels[-1].set_xlabel("along the bar (mm)")
    columns: dict[str, Any] = {"position (mm)": 1e3 * position_m}
    for name, _, _, modes in sets:
        columns |= {f"mode {k + 1} {name}": mode.shape for k, mode in enumerate(modes)}
    return finish_picture(
        figure,
        device,
        f"{device.name}: its first modes",
        f"{len(untouched)} untouched, {len(touched)} with a finger",
        columns,
        {"modes": len(untouched)},
        notes=(FINGER_NOTE,) if np.size(finger_m) else (),
    )
