"""Blocks and touches to windows, windows to drift and loads within their errors, and these to what is told and done."""

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.measure.sensor import ACCELERATION, LOOPBACK, Block, SensorError, SensorForm
from tactable.run.track_status import track_text
from tactable.track.estimator import MOST_DRIFT, Estimate, LoadEstimator, scaled_finger
from tactable.track.tracker import STEP, Tracker
from tests.engine.loop.rig import DEVICE

RATE_HZ, FINE = 3_200.0, 8
AT_M, MASS_KG, NOISE_M_PER_S2 = 0.97 * DEVICE.bar.length_m, 2e-3, 0.01
MARGIN, LENGTH = 80, 320
Fingers = Sequence[tuple[float, float]]  # position in metres, factor of the standard finger's impedance


def drifted(scale: float) -> Device:
    """The bar with Young's modulus multiplied."""
    return replace(DEVICE, surface=replace(DEVICE.bar, youngs_modulus_pa=DEVICE.bar.youngs_modulus_pa * scale))


def burst_at(start_s: float, seconds: float, seed: int = 0) -> Array:
    """Drive (time, actuator) at FINE RATE_HZ: 30 ms of tones from 60 to 300 Hz, else 0."""
    time_s = np.arange(round(seconds * RATE_HZ) * FINE) / (RATE_HZ * FINE) - start_s
    window = np.where((time_s > 0) & (time_s < 0.03), np.sin(np.pi * time_s / 0.03), 0.0)
    random = np.random.default_rng(seed)
    hz, phase = random.uniform(60, 300, (2, 3)), random.uniform(0, 2 * np.pi, (2, 3))
    tones = np.sin(2 * np.pi * hz * time_s[:, None, None] + phase).sum(axis=2)
    return np.asarray(window[:, None] * tones / 3)


def sampled(device: Device, fingers: Fingers, drive: Array, gain: float = 1.02, seed: int = 1) -> Array:
    """Samples (sample, 1 + actuator) of the sensor, lying level, for a drive (time, actuator) from rest."""
    weight = replace(device.finger, mass_kg=MASS_KG, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0)
    plant = TransientPlant(compute_basis(assemble(device)), np.array([AT_M]), RATE_HZ * FINE)
    plant.touch([(AT_M, weight), *((at_m, scaled_finger(device.finger, factor)) for at_m, factor in fingers)])
    samples = np.column_stack([gain * plant.accelerate(drive) + 9.81, drive])[::FINE]
    samples[:, 0] += NOISE_M_PER_S2 * np.random.default_rng(seed).standard_normal(len(samples))
    return samples


def window(device: Device, fingers: Fingers, seed: int = 0, start_s: float = 0.03) -> Array:
    """One window, whose burst begins `start_s` after its margin did."""
    return sampled(device, fingers, burst_at(start_s, (MARGIN + LENGTH) / RATE_HZ, seed), seed=seed)


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


NAMES = [actuator.name for actuator in DEVICE.actuators]
FINGER_M, TOUCH_S = 0.06, 0.25
MS = 1_000_000


class FakeSensor:
    """A sensor of which only form and pace are asked."""

    form = SensorForm(RATE_HZ, (ACCELERATION, *(LOOPBACK + name for name in NAMES)), (9.0, np.inf, np.inf), True)

    def fileno(self) -> int:
        return -1

    def read(self) -> Block | None:
        return None

    def pace(self) -> float:
        return 0.0

    def close(self) -> None:
        pass


class Loopless(FakeSensor):
    form = SensorForm(RATE_HZ, (ACCELERATION, LOOPBACK + NAMES[0]), (9.0, np.inf), True)


def tracker() -> Tracker:
    return Tracker(DEVICE, FakeSensor(), AT_M, MASS_KG)


def taps(scale: float, count: int) -> Array:
    """Samples of taps every 400 ms, each answered by a burst 5 ms later."""
    drive = sum(burst_at(TOUCH_S + 0.4 * tap + 5e-3, 0.4 * (count + 1), tap) for tap in range(count))
    return sampled(drifted(scale), [(FINGER_M, 1.0)], np.asarray(drive))


def feed(tracked: Tracker, samples: Array, taps: int, step: int = 32) -> int:
    """Blocks of 10 ms as a board sends them, touches as they come; how many blocks brought a window."""
    made, began_ns = 0, 1_000 * MS
    taken = [(TOUCH_S + 0.4 * tap + late_s, late_s == 0) for tap in range(taps) for late_s in (0.0, 0.3)]
    changes = [(began_ns + round(1e9 * time_s), is_down) for time_s, is_down in taken]
    for stop in range(step, len(samples) + 1, step):
        now_ns = began_ns + round(stop / RATE_HZ * 1e9) + 5 * MS
        while changes and changes[0][0] <= now_ns:
            time_ns, is_down = changes.pop(0)
            tracked.take_touches(time_ns, {time_ns: FINGER_M} if is_down else {})
        made += tracked.take_block(Block(samples[stop - step : stop], now_ns))
    return made


def test_taps_become_windows_with_their_finger_and_a_table_is_due_once_the_drift_is_more_than_a_step() -> None:
    tracked, count = tracker(), 8
    assert feed(tracked, taps(1.015, count), count) == count
    found = tracked.estimate
    assert found is not None and len(found.loads) == 1
    assert found.drift == pytest.approx(0.015, abs=3 * found.drift_error)
    assert found.drift - 2 * found.drift_error > STEP
    due = tracked.due_device()
    assert due is not None and due.bar.youngs_modulus_pa > DEVICE.bar.youngs_modulus_pa
    tracked.note_rescaled(found.drift, 3_000 * MS)
    assert tracked.due_device() is None
    text = track_text(tracked.status())
    assert "SIMULATED" in text and f"from {count} windows, 0 refused; table re-scaled to +1." in text


def test_a_finger_is_told_once_it_is_known_anew_where_it_moves_and_no_more_when_it_lifts() -> None:
    samples, tracked = sampled(DEVICE, [(FINGER_M, 1.8)], burst_at(TOUCH_S, 0.6, 1)), tracker()
    tracked.take_touches(1, {7: FINGER_M})
    assert tracked.due_fingers() is None
    tracked.take_block(Block(samples, round(1e9 * len(samples) / RATE_HZ)))
    told = tracked.due_fingers()
    assert told is not None and len(told) == 1 and told[0].position_m == FINGER_M
    assert told[0].load == pytest.approx(np.log(1.8), abs=3 * told[0].error) and told[0].error < 0.3
    assert tracked.due_fingers() is None
    for at_m, expected in ((FINGER_M + 2e-3, None), (FINGER_M + 4e-3, [FINGER_M + 4e-3])):
        tracked.take_touches(2_000 * MS, {7: at_m})
        found = tracked.due_fingers()
        assert (None if found is None else [each.position_m for each in found]) == expected
    tracked.take_touches(2_100 * MS, {})
    assert tracked.due_fingers() == []


def test_what_is_not_driven_is_no_window_and_no_drift_asks_for_no_table() -> None:
    tracked = tracker()
    assert track_text(tracked.status()) == "" and tracked.due_device() is None
    silent = taps(1.0, 3)
    silent[:, 1:] = 0.0
    assert feed(tracked, silent, 3) == 0
    still = tracker()
    assert feed(still, taps(1.0, 3), 3) == 3
    assert still.due_device() is None


def test_windows_with_lost_samples_are_left_out() -> None:
    samples, tracked = taps(1.0, 3), tracker()
    lost = round((TOUCH_S + 0.4 + 0.02) * RATE_HZ)
    samples[lost : lost + 3] = np.nan
    assert feed(tracked, samples, 3) == 2


def test_a_finger_that_moves_begins_a_new_window() -> None:
    samples, tracked = taps(1.0, 1), tracker()
    tracked.take_touches(0, {1: FINGER_M})
    tracked.take_touches(1, {1: FINGER_M + 1e-3})  # as near as it was
    count = round((TOUCH_S + 0.02) * RATE_HZ)
    tracked.take_touches(round(1e9 * count / RATE_HZ), {1: FINGER_M + 5e-3})
    tracked.take_block(Block(samples[:count], round(1e9 * count / RATE_HZ)))
    assert tracked.estimate is None, "the window with the burst is not whole when the finger moves"


def test_a_table_is_left_and_that_is_said_after_many_refusals() -> None:
    count, samples = 9, taps(1.0, 9)
    samples[:, 0] *= 4.0
    tracked = tracker()
    assert feed(tracked, samples, count) == count
    status = tracked.status()
    assert status["refused"] == count and status["windows"] == 0 and tracked.due_device() is None
    assert "the table is left as it is" in track_text(status)


def test_a_sensor_without_the_drive_beside_it_is_refused() -> None:
    with pytest.raises(SensorError, match=f"no loopback of actuator {NAMES[1]}"):
        Tracker(DEVICE, Loopless(), AT_M, MASS_KG)
