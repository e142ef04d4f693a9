"""The picture of a fit, and readings against what a table promises."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from base.points import point_of_json
from precompute.calibration.calibrate import Calibration, FittedDevice
from precompute.calibration.fitted import calibrated_device
from precompute.calibration.modal_fit import ModalCalibration
from tactable.figures.picture_file import Picture
from tactable.figures.response_picture import plot_response
from tactable.figures.style import BLACK, BLUE, GREY, ORANGE, VERMILLION, position_columns

_DOTS_PER_INCH = 120  # it is held within the report's page: fewer bytes than picture_file.py's 150


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
    """The picture as a file: modes, or the readings against the fitted device, a panel for each drive."""
    buffer = io.BytesIO()
    if isinstance(calibration, ModalCalibration):
        figure = plot_modes(calibration)
    else:
        assert isinstance(calibration, Calibration)
        device, is_wrong = calibrated_device(calibration), calibration.is_wrong
        figure = plot_response(device, calibration.measurements, has_readings=True, is_wrong=is_wrong).figure
    figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH)
    return buffer.getvalue()


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
