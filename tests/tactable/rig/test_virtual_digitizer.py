"""The made-up digitizer: what its fingers do is what the engine decodes."""

import pytest

from engine.touch import open_digitizer
from engine.touch.sources.recording import read_recording
from tactable.shipped import DEMO_RECORDING
from tests.tactable.rig.strokes import DEMO_STROKES, make_recording


def test_the_shipped_recording_is_what_the_digitizer_as_long_as_the_bar_makes() -> None:
    # Remade by: write_recording(make_recording(DEMO_STROKES), DEMO_RECORDING)
    shipped, made = read_recording(DEMO_RECORDING), make_recording(DEMO_STROKES)
    assert shipped.descriptor == made.descriptor
    assert [report.data for report in shipped.reports] == [report.data for report in made.reports]
    assert "SIMULATED" in shipped.name
    assert open_digitizer(shipped.descriptor).surface.x.extent_mm == pytest.approx(279.4, abs=1e-6)
