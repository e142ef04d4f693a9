"""The made-up digitizer: what its fingers do is what the engine decodes."""

import pytest

from engine.touch import open_digitizer
from engine.touch.sources.recording import read_recording
from tactable.rig.virtual_digitizer import X_MAXIMUM
from tactable.shipped import DEMO_RECORDING
from tests.tactable.rig.strokes import DEMO_STROKES, Stroke, make_recording


def test_the_shipped_recording_is_what_the_digitizer_as_long_as_the_bar_makes() -> None:
    # Remade by: write_recording(make_recording(DEMO_STROKES), DEMO_RECORDING)
    shipped, made = read_recording(DEMO_RECORDING), make_recording(DEMO_STROKES)
    assert shipped.descriptor == made.descriptor
    assert [report.data for report in shipped.reports] == [report.data for report in made.reports]
    assert "SIMULATED" in shipped.name
    assert open_digitizer(shipped.descriptor).surface.x.extent_mm == pytest.approx(279.4, abs=1e-6)


def test_fingers_are_decoded_where_they_were() -> None:
    strokes = (Stroke(0.0, 0.4, 0.1, 0.9), Stroke(0.1, 0.2, 0.5, 0.5))
    recording = make_recording(strokes)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    for report in recording.reports:
        frame = digitizer.decode_report(report.data, round(report.time_s * 1e9))
        assert frame is not None
        down = {i: s.place_at(report.time_s) for i, s in enumerate(strokes) if s.start_s <= report.time_s < s.stop_s}
        assert {c.contact_id: c.x for c in frame.contacts} == {i: round(p * X_MAXIMUM) for i, p in down.items()}
