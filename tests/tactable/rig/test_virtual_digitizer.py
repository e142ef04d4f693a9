"""The made-up digitizer: what its fingers do is what the engine decodes."""

from engine.touch import open_digitizer
from engine.touch.sources.recording import read_recording
from tactable.rig.virtual_digitizer import X_MAXIMUM
from tactable.shipped import DEMO_RECORDING
from tests.tactable.rig.strokes import DEMO_STROKES, FRAME_S, Stroke, make_recording


def test_the_shipped_recording_is_what_the_digitizer_makes() -> None:
    # Remade by: write_recording(make_recording(DEMO_STROKES), DEMO_RECORDING)
    shipped, made = read_recording(DEMO_RECORDING), make_recording(DEMO_STROKES)
    assert shipped.descriptor == made.descriptor
    assert [report.data for report in shipped.reports] == [report.data for report in made.reports]
    assert "SIMULATED" in shipped.name


def test_fingers_are_decoded_where_they_were() -> None:
    strokes = (Stroke(0.0, 0.4, 0.1, 0.9), Stroke(0.1, 0.2, 0.5, 0.5))
    recording = make_recording(strokes)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    for report in recording.reports:
        frame = digitizer.decode_report(report.data, round(report.time_s * 1e9))
        assert frame is not None
        down = {i: s.place_at(report.time_s) for i, s in enumerate(strokes) if s.start_s <= report.time_s < s.stop_s}
        assert {c.contact_id: c.x for c in frame.contacts} == {i: round(p * X_MAXIMUM) for i, p in down.items()}


def test_the_touch_area_is_as_long_as_the_bar() -> None:
    recording = make_recording((Stroke(0.0, FRAME_S, 0.5, 0.5),))
    surface = open_digitizer(recording.descriptor).surface
    assert surface.width_mm is not None
    assert abs(surface.width_mm - 279.4) < 1e-6
