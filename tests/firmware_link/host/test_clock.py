"""Laws of the clock comparison: the truth lies within the bounds."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.host.clock import DeviceClock, Exchange
from tests.firmware_link.strategies import unhurried

START_NS = 10**15


class TrueClocks:
    """A device clock of known offset and drift, asked over a line with delays."""

    def __init__(self, offset_ns: int, drift: float) -> None:
        self.offset_ns = offset_ns
        self.drift = drift

    def offset_at_ns(self, host_ns: int) -> float:
        return self.offset_ns + (host_ns - START_NS) * self.drift

    def exchange(self, host_ns: int, there_ns: int, back_ns: int) -> Exchange:
        arrival_ns = host_ns + there_ns
        device_us = int((arrival_ns + self.offset_at_ns(arrival_ns)) // 1000)
        return Exchange(host_ns, device_us, device_us, arrival_ns + back_ns)


delays = st.integers(0, 50_000_000)


@unhurried
@given(st.integers(-(10**14), 10**14), st.floats(-150e-6, 150e-6), st.lists(st.tuples(delays, delays), min_size=1))
def test_the_bounds_hold_the_true_offset(offset_ns: int, drift: float, trips: list[tuple[int, int]]) -> None:
    truth, clock = TrueClocks(offset_ns, drift), DeviceClock()
    host_ns = START_NS
    for there_ns, back_ns in trips:
        clock.update(truth.exchange(host_ns, there_ns, back_ns))
        host_ns += there_ns + back_ns + 500_000_000
        bounds = clock.offset_bounds(host_ns)
        assert bounds.lower_ns <= truth.offset_at_ns(host_ns) <= bounds.upper_ns
    assert clock.contradictions == 0


@pytest.mark.parametrize("drift", [-80e-6, 0.0, 45e-6])
def test_drift_is_found_through_jitter(drift: float) -> None:
    jitter = random.Random(1)
    truth, clock = TrueClocks(10**12, drift), DeviceClock()
    host_ns = START_NS
    for _ in range(120):
        clock.update(truth.exchange(host_ns, jitter.randrange(100_000, 300_000), jitter.randrange(100_000, 300_000)))
        host_ns += 980_000_000
    assert clock.drift == pytest.approx(drift, abs=3e-6)
    assert clock.device_time_us(host_ns) == pytest.approx((host_ns + truth.offset_at_ns(host_ns)) / 1000, abs=150)


def test_a_clock_tells_no_time_before_it_was_compared_and_is_taken_afresh_after_a_reboot() -> None:
    clock = DeviceClock()
    with pytest.raises(ValueError, match="not been compared"):
        clock.device_time_us(0)
    clock.update(TrueClocks(10**12, 0.0).exchange(START_NS, 1000, 1000))
    clock.update(TrueClocks(0, 0.0).exchange(START_NS + 10**9, 1000, 1000))
    assert clock.contradictions == 1
    assert abs(clock.offset_bounds(START_NS + 10**9).middle_ns) < 300_000
