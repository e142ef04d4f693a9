"""A calibration along the bar: readings against the fitted model, a panel for each drive (paper's Figures 6 and 7)."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Integers
from precompute.calibration.calibrate import Calibration, FittedDevice
from precompute.calibration.modal_fit import ModalCalibration
from tactable.figures.response_picture import reading_along
from tactable.figures.style import BLACK, BLUE, GREY, VERMILLION, draw_actuators

_DOTS_PER_INCH = 120  # it is held within the report's page: fewer bytes than picture_file.py's 150
_COLUMNS, _MOST_PANELS = 3, 12  # a page's worth


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
    measurements = calibration.measurements
    place_m, level = reading_along(calibration.device, measurements, int(rows[0]))
    axes.plot(1e3 * place_m, level, color=BLUE, lw=1.5, label="fitted")
    for is_wrong, colour, name in ((False, BLACK, "measured"), (True, VERMILLION, "measured, taken for wrong")):
        chosen = rows[calibration.is_wrong[rows] == is_wrong]
        size = np.abs(measurements.acceleration[chosen])
        axes.plot(1e3 * measurements.position_m[chosen], size, "o", ms=4, color=colour, label=name)
    draw_actuators(axes, calibration.device)
    axes.set_title(measurements.drive_text(int(rows[0])), fontsize="small")
    axes.set(xlim=(0, 1e3 * calibration.device.bar.length_m), ylim=(0, None))
    axes.set_xlabel("along the bar (mm)", fontsize="small")
    axes.set_ylabel("peak acceleration (m/s²)", fontsize="small")
    axes.grid(color=GREY, lw=0.3)
