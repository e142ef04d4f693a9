"""When a steady drive is felt first: after the bar has moved, before it is steady, by the last finger."""

from dataclasses import replace

import pytest

from engine.touch import ZoneState
from tactable.bench.latency.felt import FeltStart
from tactable.shipped import find_device
from tests.engine.made_entries import entry_of, felt_states

DEVICE = find_device("reference-a")


@pytest.fixture(scope="module")
def start() -> FeltStart:
    return FeltStart(DEVICE)


def test_a_drive_is_felt_after_it_began_and_before_it_is_steady(start: FeltStart) -> None:
    entry = entry_of(DEVICE, felt_states(DEVICE)[0], amplitudes=(1.0, 1.0))
    found_s = start.first_exceeds_s(entry)
    assert found_s is not None
    assert 1e-3 < found_s < 0.05


def test_one_that_is_never_felt_has_no_time(start: FeltStart) -> None:
    entry = entry_of(DEVICE, felt_states(DEVICE)[0], amplitudes=(1e-5, 1e-5))
    assert start.first_exceeds_s(entry) is None


def test_the_last_of_two_felt_fingers_counts(start: FeltStart) -> None:
    states = felt_states(DEVICE)
    both = next(state for state in states if list(state).count(ZoneState.FELT) == 2)
    entry = entry_of(DEVICE, both, amplitudes=(1.0, 1.0))
    found_s = start.first_exceeds_s(entry)
    assert found_s is not None
    zones = [i for i, state in enumerate(both) if state is ZoneState.FELT]
    alone = [
        tuple(zone if i != left_out else replace(zone, state=ZoneState.QUIET) for i, zone in enumerate(entry.zones))
        for left_out in zones
    ]
    assert found_s == max(start.first_exceeds_s(replace(entry, zones=each)) or 0.0 for each in alone)
