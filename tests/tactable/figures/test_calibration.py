"""The picture of a calibration: a panel a drive, the curve through noiseless readings, wrong readings set apart."""

import numpy as np

from tactable.figures.calibration import plot_calibration
from tests.precompute.calibration.calibrations import noisy_calibration


def test_there_is_a_panel_for_every_drive_with_all_its_readings() -> None:
    figure = plot_calibration(noisy_calibration())
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title() for axes in panels] == ["150 Hz and 130 Hz", "150 Hz and 200 Hz", "150 Hz and 230 Hz"]
    lines = [{line.get_label(): np.size(line.get_xdata()) for line in axes.lines} for axes in panels]
    assert all(line["measured"] + line["measured, taken for wrong"] == 22 for line in lines)
    assert sum(line["measured, taken for wrong"] for line in lines) == 3
    assert "SIMULATED" in figure.get_suptitle()
