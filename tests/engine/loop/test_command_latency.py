"""Laws of the stamps and their percentiles."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from engine.loop.command_latency import LatencyRecorder, Percentiles, Stamps

stamps = st.tuples(*(st.integers(0, 2**62),) * 6)


@given(st.lists(stamps, max_size=20), st.integers(1, 8))
def test_the_latest_are_kept_in_order_and_all_are_counted(rows: list[Stamps], capacity: int) -> None:
    recorder = LatencyRecorder(capacity)
    for row in rows:
        recorder.record(row)
    assert recorder.count == len(rows)
    assert recorder.stamps_ns().tolist() == [list(row) for row in rows[-capacity:]]


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=200))
def test_a_percentile_is_the_least_sample_that_its_share_stays_within(durations_ns: list[int]) -> None:
    recorder = LatencyRecorder()
    for duration_ns in durations_ns:
        recorder.record((5, 6, 7, 8, 9, 5 + duration_ns))
    summary = recorder.summarise()
    assert summary is not None
    assert summary == Percentiles.of([*map(float, durations_ns), np.nan])
    shares = {
        0.1: summary.p10_ns,
        0.5: summary.p50_ns,
        0.9: summary.p90_ns,
        0.99: summary.p99_ns,
        0.999: summary.p99_9_ns,
        0.9999: summary.p99_99_ns,
    }
    for share, percentile_ns in shares.items():
        assert percentile_ns in durations_ns
        assert np.mean([duration_ns <= percentile_ns for duration_ns in durations_ns]) >= share
        assert np.mean([duration_ns < percentile_ns for duration_ns in durations_ns]) < share
    assert summary.max_ns == max(durations_ns)
    assert summary.count == len(durations_ns)
