"""Windows of a simulated sensor: drift and factors are found within their errors; what is not believed is refused."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tactable.track.estimator import MOST_DRIFT, Estimate, LoadEstimator
from tests.engine.loop.rig import DEVICE
from tests.tactable.track.samples import (
    AT_M,
    LENGTH,
    MARGIN,
    MASS_KG,
    RATE_HZ,
    Fingers,
    burst_at,
    drifted,
    sampled,
    window,
)

ONE_M, OTHER_M = 0.06, 0.21


def estimator() -> LoadEstimator:
    found = LoadEstimator(DEVICE, AT_M, MASS_KG, RATE_HZ)
    assert found.margin == MARGIN
    return found


def after(windows: int, scale: float, fingers: Fingers) -> Estimate:
    """The estimate after windows with the same two fingers."""
    found, contacts = estimator(), {number: at_m for number, (at_m, _) in enumerate(fingers)}
    for seed in range(windows):
        last = found.take_window(window(drifted(scale), fingers, seed), contacts, 1.0)
        assert not last.refusal
    return last


def check_loads(found: Estimate, fingers: Fingers) -> None:
    for number, (_, factor) in enumerate(fingers):
        log_factor, error = found.loads[number]
        assert error < 0.2
        assert abs(log_factor - math.log(factor)) < 3 * error


@pytest.mark.parametrize(("scale", "factors"), [(1.0, (1.0, 1.0)), (0.985, (2.5, 0.5)), (1.02, (0.4, 1.5))])
def test_drift_and_the_load_of_each_finger_are_found_within_their_errors(
    scale: float, factors: tuple[float, float]
) -> None:
    fingers = [(ONE_M, factors[0]), (OTHER_M, factors[1])]
    found = after(6, scale, fingers)
    assert found.drift_error < 0.006
    assert found.drift == pytest.approx(scale - 1, abs=3 * found.drift_error)
    assert found.device.bar.youngs_modulus_pa > 0 and found.misfit < 0.08
    check_loads(found, fingers)


def test_less_damping_than_the_file_says_is_found_and_taken_for_no_drift() -> None:
    found, bar = estimator(), DEVICE.bar
    true = replace(DEVICE, surface=replace(bar, stiffness_damping_s=0.7 * bar.stiffness_damping_s))
    for seed in range(4):
        last = found.take_window(window(true, [(ONE_M, 1.0)], seed), {0: ONE_M}, 1.0)
        assert not last.refusal
    assert last.drift == pytest.approx(0.0, abs=3 * last.drift_error)
    assert last.device.bar.stiffness_damping_s < 0.9 * bar.stiffness_damping_s


def test_a_window_may_begin_while_the_surface_rings() -> None:
    fingers = [(ONE_M, 2.0), (OTHER_M, 0.7)]
    drive = burst_at(0.02, 0.3, 3) + burst_at(0.08, 0.3, 4)
    samples = sampled(DEVICE, fingers, drive)
    start = round(0.06 * RATE_HZ)  # the first burst has just ended
    found = estimator().take_window(samples[start : start + MARGIN + LENGTH], {0: ONE_M, 1: OTHER_M}, 0.0)
    assert not found.refusal
    check_loads(found, fingers)


def test_a_contact_that_lifts_is_forgotten_and_the_drift_is_kept() -> None:
    found, fingers = estimator(), [(ONE_M, 2.5)]
    before = found.take_window(window(drifted(1.01), fingers), {7: ONE_M}, 1.0)
    assert before.loads.keys() == {7}
    silent = np.zeros((MARGIN + LENGTH, 3))
    silent[:, 0] = 9.81 + 0.01 * np.random.default_rng(2).standard_normal(len(silent))
    again = found.take_window(silent, {8: ONE_M}, 1.0)  # nothing is driven: nothing is learned
    log_factor, error = again.loads[8]
    assert error == pytest.approx(math.log(3) / 1.96, rel=0.01)
    assert abs(log_factor) < 0.01
    assert again.drift == pytest.approx(before.drift, abs=1e-4)
    assert before.drift_error < again.drift_error < 1.2 * before.drift_error


def test_fingers_that_are_one_to_the_sensor_are_told_with_wide_errors() -> None:
    fingers = [(ONE_M, 2.0), (ONE_M + 1e-4, 2.0)]
    (_, one), (_, other) = after(2, 1.0, fingers).loads.values()
    (_, alone), _ = after(2, 1.0, [(ONE_M, 2.0), (OTHER_M, 2.0)]).loads.values()
    assert min(one, other) > 3 * alone


@pytest.mark.parametrize(
    ("samples", "why"),
    [
        (window(drifted(1.12), [(ONE_M, 1.0)]), "is beyond 3 %|not credible|residual"),
        (window(DEVICE, [(ONE_M, 1.0)])[:, [0, 2, 1]], "residual|beyond"),  # the loopbacks are exchanged
        (window(DEVICE, [(ONE_M, 1.0)]) * [3.0, 1.0, 1.0], "not credible|residual"),
    ],
)
def test_what_is_not_believed_is_refused_and_changes_nothing(samples: np.ndarray, why: str) -> None:
    found = estimator()
    first = found.take_window(window(DEVICE, [(ONE_M, 1.0)]), {1: ONE_M}, 0.0)
    refused = found.take_window(samples, {1: ONE_M}, 0.0)
    assert re.search(why, refused.refusal)
    assert refused.drift == first.drift and refused.device == first.device
    assert abs(refused.drift) < MOST_DRIFT
