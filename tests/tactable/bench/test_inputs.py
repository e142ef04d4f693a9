"""Streams of touches: taps that change the state as often as they say, whatever the rate."""

from dataclasses import replace
from itertools import cycle, islice, pairwise

import pytest

from engine.touch import open_digitizer
from engine.touch.sources.recording import read_recording
from tactable.bench.inputs import MOST_COMMANDS_HZ, expected_clicks, replayed, tapping
from tactable.shipped import DEMO_RECORDING, find_device

DEVICE = find_device("reference-a")


@pytest.mark.parametrize("fingers", [1, 2, 10])
@pytest.mark.parametrize("rate_hz", [125, 1000, 8000])
def test_each_tap_is_a_click_elsewhere_at_its_pace_of_as_many_fingers_as_asked(fingers: int, rate_hz: int) -> None:
    stream, count = tapping(fingers, rate_hz, DEVICE), 400
    every = stream.reports_per_command
    assert every == max(2, rate_hz // MOST_COMMANDS_HZ)
    clicks = expected_clicks(stream, rate_hz, count, DEVICE)
    taps = [place for report, place in clicks if report % every == 0]
    assert len(taps) == -(-count // every)
    assert all(earlier != later for earlier, later in pairwise(taps[1:]))
    # Fingers that rest have a click under way at first, which is felt again when the click of a tap ends early.
    assert all(report * 1000 < 30 * rate_hz for report, _ in clicks if report % every)
    assert stream.simulated
    digitizer = open_digitizer(stream.descriptor)
    frames = [digitizer.decode_report(report, 0) for report in islice(cycle(stream.reports), 20 * every)]
    assert {len(frame.contacts) for frame in frames if frame} == {fingers - 1, fingers}
    for wrong in (0, 11):
        with pytest.raises(ValueError, match="expected 1 to 10"):
            tapping(wrong, rate_hz, DEVICE)


def test_a_recording_comes_again_from_its_first_report() -> None:
    recording = read_recording(DEMO_RECORDING)
    stream = replayed(recording)
    count = len(recording.reports)
    again = list(islice(cycle(stream.reports), 2 * count))
    assert again[:count] == again[count:] == [report.data for report in recording.reports]
    with pytest.raises(ValueError, match="no reports"):
        replayed(replace(recording, reports=()))
