"""The first modes of a bar or a plate: their shapes, untouched and with fingers, and how fast each dies away."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from base.arrays import Points
from engine.device import Device
from precompute.model.modal import Mode
from tactable.figures.picture_file import Picture
from tactable.figures.style import BLUE, FINGER_NOTE, VERMILLION, draw_actuators, draw_zone_names, finish_picture

_MOST_PANELS = 8


def plot_modes(
    device: Device, position_m: Points, finger_m: Sequence[complex], untouched: Sequence[Mode], touched: Sequence[Mode]
) -> Picture:
    """Picture of up to eight modes, a panel each; both sets are numbered by their frequencies.

    position_m (point,): where shapes are given. A plate is seen from above, in rows of points, untouched on the left.
    """
    if np.iscomplexobj(position_m):
        return _plot_plate_modes(device, position_m, finger_m, untouched, touched)
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
    return _finished(figure, device, {"position (mm)": 1e3 * position_m}, finger_m, untouched, touched)


def _plot_plate_modes(
    device: Device, position_m: Points, finger_m: Sequence[complex], untouched: Sequence[Mode], touched: Sequence[Mode]
) -> Picture:
    count = max(1, min(_MOST_PANELS, len(untouched)))
    corner_m = device.surface.corner_m
    figure = Figure(figsize=(9, 0.6 + count * 4 * corner_m.imag / corner_m.real), layout="constrained")
    panels = figure.subplots(count, 2, sharex=True, sharey=True, squeeze=False)
    rows, extent = np.count_nonzero(position_m.real == 0), (0, 1e3 * corner_m.real, 0, 1e3 * corner_m.imag)
    for column, (name, modes) in enumerate((("untouched", untouched), ("with finger", touched))):
        for k, axes in enumerate(panels[:, column]):
            if k >= len(modes):
                axes.set_axis_off()
                continue
            shape = modes[k].shape.reshape(rows, -1)
            axes.imshow(shape, cmap="RdBu", vmin=-1, vmax=1, origin="lower", extent=extent)
            axes.contour(shape, [0.0], colors="black", linewidths=0.7, extent=extent)  # the nodal lines
            axes.set_title(f"{k + 1} {name}: {modes[k].frequency_hz:.1f} Hz", fontsize="small")
            for actuator in device.actuators:
                axes.plot(1e3 * actuator.position_m.real, 1e3 * actuator.position_m.imag, "k^", ms=5)
            for at_m in finger_m if column else ():
                axes.plot(1e3 * at_m.real, 1e3 * at_m.imag, "v", color=VERMILLION, ms=7)
    panels[-1, 0].set(xlabel="along the plate (mm)", ylabel="across (mm)")
    columns = {"along (mm)": 1e3 * position_m.real, "across (mm)": 1e3 * position_m.imag}
    return _finished(figure, device, columns, finger_m, untouched, touched)


def _finished(
    figure: Figure,
    device: Device,
    columns: dict[str, Any],
    finger_m: Sequence[complex],
    untouched: Sequence[Mode],
    touched: Sequence[Mode],
) -> Picture:
    for name, modes in (("untouched", untouched), ("with finger", touched)):
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
