"""Scan time: the digitizer's period is told apart from what the host adds."""

import numpy as np
import pytest

from engine.loop.command_latency import ScanTimes

MS = 1_000_000


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


def test_few_frames_say_nothing_and_a_capacity_too_small_is_refused() -> None:
    assert times(50, 100_000.0, np.zeros(50)).summarise() is None
    assert ScanTimes().summarise() is None
    with pytest.raises(ValueError, match="capacity is 1"):
        ScanTimes(1)
