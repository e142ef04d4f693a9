"""Readings against the fitted model, a panel for each drive (on a bar the paper's Figures 6 and 7), or a promise."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Integers, even_points
from base.points import point_of_json
from precompute.calibration.calibrate import Calibration, FittedDevice
from precompute.calibration.modal_fit import ModalCalibration
from tactable.figures.picture_file import Picture
from tactable.figures.response_picture import reading_at
from tactable.figures.style import (
    BLACK,
    BLUE,
    COLOUR_MAP,
    GREY,
    ORANGE,
    VERMILLION,
    draw_actuators,
    position_columns,
    surface_field,
)

_DOTS_PER_INCH = 120  # it is held within the report's page: fewer bytes than picture_file.py's 150
_COLUMNS, _MOST_PANELS = 3, 12  # a page's worth
_MAP = 61, 37  # points of a map, along and across: 5 mm apart on a tablet
_READINGS = (False, BLACK, "measured"), (True, VERMILLION, "measured, taken for wrong")


def plot_calibration(calibration: Calibration) -> Figure:
    """At most a dozen drives, evenly chosen; the curve has the sensor at each place, as the readings had."""
    measurements, device = calibration.measurements, calibration.device
    drive = measurements.drive_of_row
    drives = np.unique(np.linspace(0, drive.max(), min(int(drive.max()) + 1, _MOST_PANELS)).round().astype(np.int64))
    columns = min(_COLUMNS, len(drives))
    rows = -(-len(drives) // columns)
    figure = Figure(figsize=(1.2 + 3.9 * columns, 1.3 + 2.7 * rows), layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, squeeze=False)).ravel()
    for panel, number in zip(panels, drives, strict=False):
        _draw(panel, calibration, np.flatnonzero(drive == number))
    for panel in panels[len(drives) :]:
        panel.set_visible(False)
    if np.iscomplexobj(measurements.position_m):
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize="x-small")
    else:
        panels[0].legend(fontsize="x-small")
    typical = 100 * float(np.median(np.abs(calibration.log_residual)))
    simulated = " SIMULATED" if measurements.is_simulated else ""
    figure.suptitle(
        f"{device.name}{simulated}: {len(measurements)} readings, typical misfit {typical:.2g} %; "
        f"{len(drives)} of {int(drive.max()) + 1} drives",
        fontsize="medium",
    )
    return figure


def plot_modes(calibration: ModalCalibration) -> Figure:
    """Damping ratio over frequency of the measured modes, with standard errors, and of the fitted ones."""
    modes, damping = calibration.modes, 100 * calibration.modes.damping_ratio
    figure = Figure(figsize=(6.5, 4), layout="constrained")
    axes = figure.subplots()
    axes.errorbar(modes.frequency_hz, damping, modes.damping_error * damping, fmt="o", color=BLACK, label="measured")
    axes.plot(calibration.fitted_hz, 100 * calibration.fitted_damping, "x", color=BLUE, label="fitted")
    simulated = " SIMULATED" if modes.is_simulated else ""
    axes.set(yscale="log", xlabel="frequency (Hz)", ylabel="damping ratio (%)")
    axes.set_title(f"{calibration.device.name}{simulated}: {len(modes)} modes", fontsize="medium")
    axes.legend(fontsize="x-small")
    axes.grid(color=GREY, lw=0.3)
    return figure


def calibration_png(calibration: FittedDevice) -> bytes:
    """The picture as a file."""
    buffer = io.BytesIO()
    if isinstance(calibration, ModalCalibration):
        figure = plot_modes(calibration)
    else:
        assert isinstance(calibration, Calibration)
        figure = plot_calibration(calibration)
    figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH)
    return buffer.getvalue()


def _draw(axes: Axes, calibration: Calibration, rows: Integers) -> None:
    measurements, device = calibration.measurements, calibration.device
    axes.set_title(measurements.drive_text(int(rows[0])), fontsize="small")
    if np.iscomplexobj(measurements.position_m):
        _draw_from_above(axes, calibration, rows)
        return
    place_m = surface_field(device).position_m.real
    axes.plot(
        1e3 * place_m, reading_at(device, measurements, int(rows[0]), place_m), color=BLUE, lw=1.5, label="fitted"
    )
    for is_wrong, colour, name in _READINGS:
        chosen = rows[calibration.is_wrong[rows] == is_wrong]
        size = np.abs(measurements.acceleration[chosen])
        axes.plot(1e3 * measurements.position_m[chosen].real, size, "o", ms=4, color=colour, label=name)
    draw_actuators(axes, device)
    axes.set(xlim=(0, 1e3 * device.bar.length_m), ylim=(0, None))
    axes.set_xlabel("along the bar (mm)", fontsize="small")
    axes.set_ylabel("peak acceleration (m/s²)", fontsize="small")
    axes.grid(color=GREY, lw=0.3)


def _draw_from_above(axes: Axes, calibration: Calibration, rows: Integers) -> None:
    """The fitted readings as a map, and on it the measured ones as discs of the same colours."""
    measurements, device = calibration.measurements, calibration.device
    corner_m, place_m = device.surface.corner_m, even_points(0j, device.surface.corner_m, *_MAP)
    fitted = reading_at(device, measurements, int(rows[0]), place_m).reshape(_MAP[::-1])
    greatest = float(max(fitted.max(), np.abs(measurements.acceleration[rows]).max()))
    extent = (0, 1e3 * corner_m.real, 0, 1e3 * corner_m.imag)
    scale: dict[str, Any] = {"cmap": COLOUR_MAP, "vmin": 0.0, "vmax": greatest}
    drawn = axes.imshow(fitted, origin="lower", extent=extent, interpolation="bilinear", **scale)
    for is_wrong, colour, name in _READINGS:
        chosen = rows[calibration.is_wrong[rows] == is_wrong]
        at_mm, size = 1e3 * measurements.position_m[chosen], np.abs(measurements.acceleration[chosen])
        axes.scatter(at_mm.real, at_mm.imag, 60, size, edgecolors=colour, label=name, zorder=3, **scale)
    base_mm = 1e3 * np.array([actuator.position_m for actuator in device.actuators])
    axes.plot(base_mm.real, base_mm.imag, "^", color="white", mec=BLACK, ms=6, label="actuators")
    axes.figure.colorbar(drawn, ax=axes, shrink=0.6).set_label("peak, map: fitted (m/s²)", fontsize="x-small")
    axes.set(xlim=extent[:2], ylim=extent[2:])
    axes.tick_params(labelbottom=True)
    axes.set_xlabel("along the plate (mm)", fontsize="small")
    axes.set_ylabel("across (mm)", fontsize="small")


_COLOURS = {"kept": BLACK, "broken": VERMILLION, "not shown": ORANGE, "spoiled": GREY}
_SIZES = ("promised", "low", "high", "read", "error")


def plot_verification(title: str, points: Sequence[Mapping[str, Any]]) -> Picture:
    """Readings and their errors over the promised peaks with their intervals, from the points of a summary."""
    promised, low, high, read, error = np.array([[point[f"{k}_m_per_s2"] for point in points] for k in _SIZES])
    kind, outcome = ([point[key] for point in points] for key in ("kind", "outcome"))
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
            these = chosen & np.array([each == named for each in outcome], dtype=bool)
            off = np.minimum(error[these], 0.999 * read[these]), error[these]  # down to a place on the axis
            panel.errorbar(promised[these], read[these], off, fmt=".", color=colour, label=named, elinewidth=0.6)
        panel.legend(fontsize="x-small")
    figure.suptitle(title, fontsize="medium")
    sizes = {f"{k} (m/s^2)": values for k, values in zip(_SIZES, (promised, low, high, read, error), strict=True)}
    at_m = np.array([point_of_json(point["position_m"]) for point in points])
    return Picture(figure, {"kind": kind, **position_columns(at_m), **sizes, "outcome": outcome}, {}, title)
