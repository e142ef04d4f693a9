"""Laws of a recording played as a source."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.touch.sources import Source
from engine.touch.sources.playback import Playback
from engine.touch.sources.recording import Recording, Report

START_NS = 10**15
speeds = st.floats(0.01, 1000)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    times_us = sorted(draw(st.lists(st.integers(0, 10**9), min_size=1, max_size=10)))
    reports = tuple(Report(index, time_us / 1e6, bytes([index])) for index, time_us in enumerate(times_us))
    return Recording("bar", 3, 0x04F3, 0x200A, b"\x05\x0d", reports)


def play(source: Source) -> list[tuple[int, int, bytes]]:
    """Clock time, index and data of each report, read when it is due and never earlier."""
    now_ns, played = START_NS, []
    while not source.ended:
        due_ns = source.next_time_ns()
        assert due_ns is not None
        if due_ns > now_ns:
            assert source.read(due_ns - 1) is None
        now_ns = max(now_ns, due_ns)
        report = source.read(now_ns)
        assert report is not None
        played.append((now_ns, source.report_index, report))
    assert source.read(now_ns + 10**12) is None
    assert source.next_time_ns() is None
    return played


@given(recordings(), speeds)
def test_reports_come_at_their_own_pace_times_the_speed(recording: Recording, speed: float) -> None:
    played = play(Playback(recording, speed))
    first_s = recording.reports[0].time_s
    for (clock_ns, index, data), report in zip(played, recording.reports, strict=True):
        assert (index, data) == (report.index, report.data)
        assert clock_ns - START_NS == pytest.approx((report.time_s - first_s) * 1e9 / speed, rel=1e-9, abs=2)


@given(recordings())
def test_without_a_speed_every_report_is_due_at_once(recording: Recording) -> None:
    played = play(Playback(recording, speed=None))
    assert [(index, data) for _, index, data in played] == [(r.index, r.data) for r in recording.reports]
    assert {clock_ns for clock_ns, _, _ in played} == {START_NS}


@given(recordings(), st.none() | speeds)
def test_report_times_are_those_of_the_recording_at_any_speed(recording: Recording, speed: float | None) -> None:
    source = Playback(recording, speed)
    for report in recording.reports:
        source.read(source.next_time_ns() or START_NS)
        assert source.report_time_ns == round(report.time_s * 1e9)


@given(recordings(), st.none() | speeds, st.integers(0, 10**12))
def test_a_deadline_in_the_recording_has_come_at_its_clock_time(
    recording: Recording, speed: float | None, wait_ns: int
) -> None:
    source = Playback(recording, speed)
    source.read(START_NS)
    deadline_ns = source.report_time_ns + wait_ns
    assert source.source_time_ns(source.clock_time_ns(deadline_ns)) >= deadline_ns
    pace = speed or 1.0
    assert source.clock_time_ns(deadline_ns) - START_NS == pytest.approx(wait_ns / pace, rel=1e-9, abs=2)


def test_what_the_recording_says_of_the_device_is_passed_on() -> None:
    source: Source = Playback(Recording("bar", 3, 0x04F3, 0x200A, b"\x05\x0d", ()))
    assert (source.name, source.vendor_id, source.product_id) == ("bar", 0x04F3, 0x200A)
    assert (source.descriptor, source.fileno(), source.ended) == (b"\x05\x0d", None, True)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.inf, math.nan])
def test_a_speed_that_leads_nowhere_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="expected a number above 0"):
        Playback(Recording("", 0, 0, 0, b"", ()), speed)
