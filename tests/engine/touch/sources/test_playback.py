"""Laws of a recording played as a source."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.touch.sources import Source
from engine.touch.sources.recording import PAUSE_NS, Playback, Recording, Report

START_NS = 10**15
speeds = st.none() | st.floats(0.01, 1000)
"""None: every report is due at once."""


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    times_us = sorted(draw(st.lists(st.integers(0, 10**9), min_size=1, max_size=10)))
    reports = tuple(Report(index, time_us / 1e6, bytes([index])) for index, time_us in enumerate(times_us))
    return Recording("bar", 3, 0x04F3, 0x200A, b"\x05\x0d", reports)


@given(recordings(), speeds)
def test_reports_come_at_their_pace_times_the_speed_with_their_times(recording: Recording, speed: float | None) -> None:
    """Each is read when it is due and never earlier."""
    source: Source = Playback(recording, speed)
    now_ns, first_s = START_NS, recording.reports[0].time_s
    for report in recording.reports:
        due_ns = source.next_time_ns()
        assert due_ns is not None and not source.ended
        if due_ns > now_ns:
            assert source.read(due_ns - 1) is None
        now_ns = max(now_ns, due_ns)
        assert source.read(now_ns) == report.data
        assert (source.report_index, source.report_time_ns) == (report.index, round(report.time_s * 1e9))
        pause_ns = 0 if speed is None else (report.time_s - first_s) * 1e9 / speed
        assert now_ns - START_NS == pytest.approx(pause_ns, rel=1e-9, abs=2)
    assert source.ended
    assert (source.read(now_ns + 10**12), source.next_time_ns()) == (None, None)


@given(recordings(), speeds)
def test_what_is_repeated_goes_on_after_its_end_with_rising_times(recording: Recording, speed: float | None) -> None:
    source, now_ns, taken = Playback(recording, speed, repeats=True), START_NS, list[tuple[bytes, int]]()
    for _ in range(2 * len(recording.reports) + 1):
        due_ns = source.next_time_ns()
        assert due_ns is not None
        now_ns = max(now_ns, due_ns)
        report = source.read(now_ns)
        assert report is not None
        taken.append((report, source.report_time_ns))
    first = [report.data for report in recording.reports]
    assert [data for data, _ in taken] == [*first, *first, first[0]]
    gaps_ns = [after - before for (_, before), (_, after) in pairwise(taken)]
    assert min(gaps_ns) >= 0
    assert gaps_ns[len(first) - 1] == gaps_ns[2 * len(first) - 1] == PAUSE_NS
    assert not source.ended


@pytest.mark.parametrize("speed", [0.0, -1.0, math.inf, math.nan])
def test_a_speed_that_leads_nowhere_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="expected a number above 0"):
        Playback(Recording("", 0, 0, 0, b"", ()), speed)
