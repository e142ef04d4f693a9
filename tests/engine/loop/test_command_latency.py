"""Laws of the stamps and their percentiles, and of scan times: a digitizer's period is told apart from the host's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.loop.command_latency import LatencyRecorder, Percentiles, ScanTimes, Stamps

stamps = st.tuples(*(st.integers(0, 2**62),) * 6)


@given(st.lists(stamps, max_size=20), st.integers(1, 8))
def test_the_latest_are_kept_in_order_and_all_are_counted(rows: list[Stamps], capacity: int) -> None:
    recorder = LatencyRecorder(capacity)
    for row in rows:
        recorder.record(*row)
    assert recorder.count == len(rows)
    assert recorder.rows_ns().tolist() == [list(row) for row in rows[-capacity:]]


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=200))
def test_a_percentile_is_the_least_sample_that_its_share_stays_within(durations_ns: list[int]) -> None:
    recorder = LatencyRecorder()
    for duration_ns in durations_ns:
        recorder.record(5, 6, 7, 8, 9, 5 + duration_ns)
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


def times(count: int, tick_ns: float, late_ns: np.ndarray[tuple[int], np.dtype[np.float64]]) -> ScanTimes:
    """A device of 8 ms whose 100 us take `tick_ns`, behind a host that is late."""
    kept = ScanTimes(capacity=400)
    for index in range(count):
        scan_ns = 80 * 100_000 * index
        kept.record(round(80 * tick_ns * index + late_ns[index]), scan_ns)
    return kept


@pytest.mark.parametrize("count", [100, 400, 1000])
@pytest.mark.parametrize("tick_ns", [92_000.0, 100_000.0, 131_000.0])
def test_a_punctual_host_shows_the_device_alone(count: int, tick_ns: float) -> None:
    found = times(count, tick_ns, np.zeros(count)).summarise()
    assert found is not None
    assert found.period_ns == pytest.approx(80 * tick_ns, rel=1e-6)
    assert found.jitter_p99_ns < 1_000


def test_few_frames_say_nothing() -> None:
    assert times(50, 100_000.0, np.zeros(50)).summarise() is None
    assert ScanTimes().summarise() is None
