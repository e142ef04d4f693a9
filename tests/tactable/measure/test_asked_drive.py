"""Levels along the bar by the model, against the sum over tones and the plant in time."""

import numpy as np
import pytest

from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from tactable.measure.asked_drive import AskedDrive, simulate_levels
from tactable.rig.simulated_surface import SimulatedSurface
from tests.engine.loop.rig import DEVICE


@pytest.mark.parametrize("hz", [(150.0, 150.0), (150.0, 130.0)])
def test_the_levels_are_those_of_the_bar_in_time(hz: tuple[float, float]) -> None:
    asked = AskedDrive(hz, (0.2, 0.1), (0.0, 1.0))
    channels = tuple(ChannelTarget(*each) for each in zip(hz, asked.amplitudes, asked.phases_rad, strict=True))
    bar = SimulatedSurface(DEVICE)
    in_time = bar.simulate_held(DriveEvent(0, Cause.SET, 1, 200.0, channels), ())
    peak_m_per_s2, level_db = simulate_levels(DEVICE, asked, bar.point_m)
    assert peak_m_per_s2 == pytest.approx(in_time.acceleration, rel=0.02)
    # Tones of two frequencies add as powers, so that their level is less than that of the sum of their peaks.
    highest_db = 20 * np.log10(peak_m_per_s2 / DEVICE.threshold.peak_m_per_s2(np.array(hz[:1])))
    assert (level_db == pytest.approx(highest_db)) == (hz[0] == hz[1])
    assert (level_db <= highest_db + 1e-9).all()
