"""Laws of the judge of entries: fields of the dense models, exact slopes, climbs that end higher than they began."""

from functools import cache

import numpy as np
import pytest

from engine.touch import ZoneState
from precompute.sampling.fingers import sample_fingers
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import random_device, shipped
from tests.precompute.entries.rivals import BEAT_HZ, best_starts, climb, judge_tries, partitions, random_tries, rival
from tests.precompute.predict.dense_state import DenseState
from tests.quick import first_quick

DEVICES = {"two actuators": shipped("reference-a"), "three actuators": random_device(20230247606)}
any_device = pytest.mark.parametrize("name", first_quick(reversed(DEVICES)))
FREE, QUIET, FELT = ZoneState
STATES = {
    "felt and quiet": (FELT, FREE, QUIET, FELT, FREE),
    "nothing free": (FELT, QUIET, QUIET, FELT, QUIET),
    "nothing quiet": (FELT, FREE, FREE, FELT, FREE),
}


@cache
def state_of(name: str, states: str, loudest: bool = False) -> DenseState:
    device = DEVICES[name]
    return DenseState(DenseModel(device), sample_fingers(device), STATES[states][: len(device.zones)], loudest)


@any_device
def test_side_by_side_the_touches_move_as_each_dense_model_alone(name: str) -> None:
    state, hz = state_of(name, "felt and quiet"), 187.3
    fields = state.unit_fields(hz)[0]
    for case in (0, 1, 32):
        expected = state.models[case].unit_field(np.array([hz]))[0] / -((2 * np.pi * hz) ** 2)
        assert abs(fields[case] - expected).max() <= 1e-7 * abs(expected).max()


@any_device
@pytest.mark.parametrize("states", STATES)
@pytest.mark.parametrize("loudest", first_quick([True, False]))
def test_slopes_over_frequency_are_those_of_finite_differences(name: str, states: str, loudest: bool) -> None:
    state, hz, step = state_of(name, states, loudest), 187.3, 1e-3
    difference = (state.forms(hz + step)[0] - state.forms(hz - step)[0]) / (2 * step)
    slope = state.forms(hz)[1]
    scale = abs(slope).max(axis=(1, 2), keepdims=True) + abs(state.forms(hz)[0]).max(axis=(1, 2), keepdims=True) / hz
    assert (abs(slope - difference) <= 1e-4 * scale).all()


def test_partitions_are_every_way_to_share_actuators_among_tones() -> None:
    assert [len(partitions(count)) for count in (1, 2, 3, 4)] == [1, 2, 5, 15]
    assert partitions(3)[0] == (0, 0, 0)


@any_device
def test_tries_are_of_every_family_and_none_beats_and_each_is_judged_as_alone(name: str) -> None:
    device, state = DEVICES[name], state_of(name, "felt and quiet")
    count = len(device.actuators)
    tries = random_tries(device, np.full(count, 187.3), np.ones(count, dtype=complex), 3000, np.random.default_rng(0))
    judge_tries(state, tries)
    assert {tuple(tone) for tone in tries.tone.tolist()} == set(partitions(count))
    for k in range(0, 3000, 300):
        alone = rival(state, tries.frequency_hz[tries.place[k]], tries.amplitude[k])
        assert (alone.ratio, alone.level) == pytest.approx((tries.ratio[k], tries.level[k]))
        tones = np.unique(alone.frequency_hz)
        assert (np.diff(tones) >= BEAT_HZ).all()


@pytest.mark.parametrize(
    ("name", "loudest"),
    [
        ("two actuators", True),
        *(pytest.param(name, False, marks=pytest.mark.long) for name in ("two actuators", "three actuators")),
        pytest.param("three actuators", True, marks=pytest.mark.long),
    ],
)
def test_a_climb_ends_no_lower_than_the_try_it_began_from(name: str, loudest: bool) -> None:
    device, state = DEVICES[name], state_of(name, "felt and quiet", loudest)
    count, wanted = len(device.actuators), 0.0 if loudest else 100.0
    tries = random_tries(device, np.full(count, 187.3), np.ones(count, dtype=complex), 3000, np.random.default_rng(0))
    judge_tries(state, tries)
    starts = [start for start in best_starts(tries, wanted, 8) if tries.level[start] >= wanted]
    assert starts
    gains = []
    for start in starts:
        found = climb(state, device, tries, start, wanted)
        assert found.level >= wanted * (1 - 1e-4)
        gains.append(found.ratio / tries.ratio[start])
    assert min(gains) >= 0.999
    assert max(gains) > 1.01
