"""Laws of drives at positions: near a proved bound, true in a dense model, within limits; and of packed forms.

Drives and levels in NumPy are compared with those of the compiled solver and of finite elements.
"""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array, Complex
from engine.device import Device, Finger
from engine.steady import SteadyDrive
from engine.steady.ascent import evaluate
from engine.steady.cases import FingerCases, cases_at, sample_deviations
from engine.steady.forms import fill_products, multiply, power_of, solve
from engine.steady.plain_solver import PlainSolver
from engine.steady.steady_drive import CASES, compute_levels
from engine.steady.steady_solver import FOLLOWED_HZ, SteadyError
from engine.touch.placement import MOST_FINGERS
from precompute.predict.at_positions import SAMPLES
from tests.engine.steady.bound import DEVICES, bound_db, designer_of, mean_forms, ratio_db
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import shipped
from tests.precompute.sampled import threshold
from tests.quick import first_quick

TOLERANCE_DB = 0.05
INTERPOLATED_DB = 0.1
"""No contrast is off by more than this from the plant solved at the frequency of the drive."""
any_device = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if name[-2:] in ("-d", "-t") else ()) for name in DEVICES]
)
MOST_LOST_DB, MEDIAN_LOST_DB = 4.0, 1.0
"""Of the expected contrast, or of the level where the loudest drive is asked for."""
ENOUGH_DB = 25.0
"""With it a finger beside one at 20 dB is 5 dB below the threshold: more is not felt."""
POSITIONS_M, ROLES = (0.035, 0.12, 0.15), (True, False, False)
PERCENTS = (5, 50, 95)


@pytest.mark.parametrize("placements", [pytest.param(8, marks=pytest.mark.long), 3])
@pytest.mark.parametrize("name", DEVICES)
def test_half_of_the_drives_meet_their_bound_and_all_keep_what_is_said(name: str, placements: int) -> None:
    """At a level that every drive reaches. That an optimum misses its bound is no fault: a bound may have a gap."""
    device, random = DEVICES[name], np.random.default_rng(7)
    solver, gaps_db, errors_db = designer_of(device).solver, list[float](), list[float]()
    band_hz = [actuator.band_hz for actuator in device.actuators]
    for _ in range(placements):
        fingers = int(random.integers(2, 4))
        position_m = np.sort(random.uniform(0, device.bar.length_m, fingers))
        while np.diff(position_m).min() < 0.025:
            position_m = np.sort(random.uniform(0, device.bar.length_m, fingers))
        felt = np.arange(fingers) == random.integers(fingers)
        cases = cases_at(position_m, sample_deviations(fingers, 8), device)
        drive = solver.solve(position_m.tolist(), felt.tolist(), -20.0)
        hz = np.union1d(np.arange(device.sweep.start_hz, device.sweep.stop_hz, 2.0), drive.frequency_hz)
        usable = np.stack([(hz >= low) & (hz <= high) for low, high in band_hz], axis=1)
        forms = mean_forms(device, _sampled(cases), hz)
        assert drive.objective == "contrast" and drive.achieved
        contrast_db = ratio_db(forms[:, hz == drive.frequency_hz][:, 0], felt, drive.complex_amplitudes)
        gaps_db.append(bound_db(forms, felt, usable) - contrast_db)
        errors_db.append(abs(drive.value - contrast_db))
    assert min(gaps_db) > -0.01  # or it is no bound
    assert np.median(gaps_db) < TOLERANCE_DB
    assert max(errors_db) < INTERPOLATED_DB


def _sampled(cases: FingerCases) -> FingerCases:
    return FingerCases(cases.position_m[1:], cases.impedance[1:])


@any_device
@pytest.mark.parametrize("fingers", first_quick([10, 1, 2, 3, 5]))
def test_fingers_feel_what_a_dense_model_says(name: str, fingers: int) -> None:
    device, random = DEVICES[name], np.random.default_rng(fingers)
    solver = designer_of(device).solver
    for level_db in (12.0, np.inf):
        positions_m = random.uniform(0, device.bar.length_m, fingers).tolist()
        if fingers > 3:
            positions_m[:3] = [0.0, device.actuators[0].position_m, device.bar.length_m]
        felt = [True, *(random.random(fingers - 1) < 0.3).tolist()]
        drive = solver.solve(positions_m, felt, level_db)
        count = len(drive.sampled_level_db)
        cases = cases_at(np.array(positions_m), sample_deviations(fingers, count), device)
        told_db = np.concatenate([drive.level_db[None], drive.sampled_level_db])
        dense_db = dense_levels(device, cases, drive)
        # What is 50 dB below the strongest finger has no influence on any figure.
        heard = dense_db > dense_db.max() - 50
        assert abs(told_db - dense_db)[heard].max() < 0.25
        assert abs(told_db - dense_db)[dense_db > dense_db.max() - 20].max() < 0.05


def dense_levels(device: Device, cases: FingerCases, drive: SteadyDrive) -> Array:
    """Levels in dB (case, finger) under the drive, each case's fingers assembled into dense matrices."""
    bare, rows = DenseModel(device), []
    for position_m, impedance in zip(cases.position_m, cases.impedance, strict=True):
        fingers = [
            (at, Finger(mass_kg=m, damping_n_s_per_m=c, stiffness_n_per_m=k, spread=1.0))
            for at, (k, c, m) in zip(position_m.tolist(), impedance.tolist(), strict=True)
        ]
        field = bare.touched(fingers).unit_acceleration(np.array([drive.frequency_hz]), position_m)[0]
        rows.append(abs(field @ drive.complex_amplitudes) / threshold(drive.frequency_hz))
    decibels: Array = 20 * np.log10(np.array(rows))
    return decibels


@any_device
@pytest.mark.parametrize("fingers", [1, 2, 4, 10])
@pytest.mark.parametrize("level_db", [5.0, 20.0, 45.0, np.inf])
def test_no_drive_exceeds_its_amplitude_its_level_or_its_band(name: str, fingers: int, level_db: float) -> None:
    device, random = DEVICES[name], np.random.default_rng(fingers)
    positions_m = random.uniform(0, device.bar.length_m, fingers).tolist()
    felt = [True, *(random.random(fingers - 1) < 0.5).tolist()]
    drive = designer_of(device).solver.solve(positions_m, felt, level_db)
    assert max(drive.amplitudes) <= device.limits.amplitude
    assert drive.weakest_felt_db <= level_db + 1e-9
    assert drive.achieved == (np.isinf(level_db) or drive.weakest_felt_db >= level_db - 1e-3)
    assert drive.achieved or max(drive.amplitudes) == pytest.approx(device.limits.amplitude)
    for amplitude, actuator in zip(drive.amplitudes, device.actuators, strict=True):
        assert amplitude < 1e-9 or actuator.band_hz[0] <= drive.frequency_hz <= actuator.band_hz[1]


def test_a_drive_that_follows_keeps_to_its_peak_while_that_is_good_enough() -> None:
    solver, jumps = designer_of(shipped("reference-a")).solver, [0, 0]
    random = np.random.default_rng(5)
    for felt_m, from_m in random.uniform(0.0, 0.24, (30, 2)).tolist():
        if abs(felt_m - from_m) < 0.06:
            continue
        held_hz = free_hz = None
        for quiet_m in np.arange(from_m, from_m + 0.03, 5e-4).tolist():
            fingers = sorted([(felt_m, True), (quiet_m, False)])
            asked = [at_m for at_m, _ in fingers], [is_felt for _, is_felt in fingers], 20.0
            free, kept = solver.solve(*asked), solver.solve(*asked, held_hz)
            assert kept.achieved == free.achieved and kept.value >= min(18.0, free.value - 6.0) - 1e-6
            if held_hz is not None and free_hz is not None:
                jumps[0] += abs(free.frequency_hz - free_hz) > FOLLOWED_HZ
                jumps[1] += abs(kept.frequency_hz - held_hz) > FOLLOWED_HZ
            # Whoever knows the drive's own frequency finds this drive again.
            again = solver.solve(*asked, kept.frequency_hz)
            assert again.value == pytest.approx(kept.value, abs=0.01)
            assert again.frequency_hz == pytest.approx(kept.frequency_hz, abs=0.1)
            held_hz, free_hz = kept.frequency_hz, free.frequency_hz
    assert jumps[1] < 0.7 * jumps[0]


def test_one_actuator_has_its_frequency_to_choose() -> None:
    device = shipped("reference-a")
    alone = replace(device, actuators=device.actuators[:1])
    drive = designer_of(alone).solver.solve([0.06, 0.2], [True, False], 10.0)
    both = designer_of(device).solver.solve([0.06, 0.2], [True, False], 10.0)
    assert drive.achieved and len(drive.amplitudes) == 1
    assert 0 < drive.value < both.value


def test_with_nothing_quiet_the_share_of_the_felt_zone_is_maximised() -> None:
    device = shipped("reference-a")
    drive = designer_of(device).solver.solve([0.03], [True], 10.0)
    assert drive.objective == "localized factor" and 0 < drive.value < 1
    everywhere = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    assert designer_of(device).solver.solve(everywhere, [True] * 5, 10.0).objective == "level"


@pytest.mark.parametrize(
    ("positions_m", "felt", "level_db", "words"),
    [
        ([0.3], [True], 20.0, "finger 1 at 300 mm: the surface ends at 279.4 mm"),
        ([0.1, -0.001], [True, False], 20.0, "finger 2 at -1 mm"),
        ([float("nan")], [True], 20.0, "finger 1 at nan mm"),
        ([0.1], [False], 20.0, "no finger is felt"),
        ([], [], 20.0, "0 fingers"),
        ([0.01 * k for k in range(MOST_FINGERS + 1)], [True] * 11, 20.0, "11 fingers: a drive is solved for one to 10"),
        ([0.1, 0.2], [True], 20.0, "2 positions and 1 roles"),
        ([0.1], [True], float("nan"), "the level is not a number"),
    ],
)
def test_a_wrong_placement_is_refused(positions_m: list[float], felt: list[bool], level_db: float, words: str) -> None:
    with pytest.raises(SteadyError, match=words):
        designer_of(shipped("reference-a")).solver.solve(positions_m, felt, level_db)


def packed(matrix: Complex) -> Array:
    """The diagonal, then real and imaginary parts of the elements above it, row by row."""
    above = matrix[np.triu_indices(len(matrix), 1)]
    return np.concatenate([matrix.diagonal().real, np.stack([above.real, above.imag], axis=1).ravel()])


def random_forms(random: np.random.Generator, count: int, actuators: int) -> Complex:
    factor = random.normal(size=(count, actuators, actuators)) + 1j * random.normal(size=(count, actuators, actuators))
    forms: Complex = factor.conj().transpose(0, 2, 1) @ factor
    return forms


@pytest.mark.parametrize("actuators", [1, 2, 3, 5])
def test_packed_forms_are_the_dense_ones(actuators: int) -> None:
    random = np.random.default_rng(actuators)
    matrix = random_forms(random, 1, actuators)[0]
    a = random.normal(size=actuators) + 1j * random.normal(size=actuators)
    products, image, found = np.empty(actuators**2), np.empty_like(a), np.empty_like(a)
    fill_products(a, products)
    assert power_of(packed(matrix), products) == pytest.approx((a.conj() @ matrix @ a).real)
    multiply(packed(matrix), a, image)
    assert image == pytest.approx(matrix @ a)
    solve(packed(matrix), a, found, np.empty((actuators, actuators), dtype=np.complex128))
    exact = np.linalg.solve(matrix, a)
    assert found / found[0] == pytest.approx(exact / exact[0])  # its length is free


@pytest.mark.parametrize("actuators", [2, 3])
@pytest.mark.parametrize("log_wanted", [-5.0, 0.0, 5.0])
def test_the_gradient_is_that_of_the_objective(actuators: int, log_wanted: float) -> None:
    random = np.random.default_rng(3)
    forms = np.array([packed(each) for each in random_forms(random, 5, actuators)])
    a = random.normal(size=actuators) + 1j * random.normal(size=actuators)
    usable, gradient = np.ones(actuators, dtype=np.bool_), np.empty(actuators, dtype=np.complex128)
    work = np.empty((4, 5 + actuators**2))

    def value_at(drive: Complex, out: Complex) -> float:
        return float(evaluate(drive, usable, forms, 2, 2, log_wanted, 10.0, out, work))

    value_at(a, gradient)
    for direction in (np.eye(actuators)[0] + 0j, 1j * np.eye(actuators)[1]):
        step = 1e-6 * direction
        slope = (value_at(a + step, np.empty_like(a)) - value_at(a - step, np.empty_like(a))) / 2e-6
        assert slope == pytest.approx((direction.conj() @ gradient).real, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("name", ["reference-a", "reference-t"])
def test_drives_are_nearly_as_good_as_those_of_the_compiled_solver(name: str) -> None:
    device = DEVICES[name]
    exact, random, lost_db = designer_of(device).solver, np.random.default_rng(7), list[float]()
    plain = PlainSolver(device, designer_of(device).modes)
    for fingers in (2, 2, 2, 2, 3, 3, 4):
        position_m = (np.arange(fingers) + random.uniform(0.2, 0.8, fingers)) * device.bar.length_m / fingers
        felt = [finger != fingers - 1 if fingers == 4 else finger == 0 for finger in range(fingers)]
        best, found = (each.solve(position_m.tolist(), felt, 20.0) for each in (exact, plain))
        assert (found.objective, found.achieved) == (best.objective, best.achieved)
        assert found.weakest_felt_db == pytest.approx(20.0, abs=1e-6)
        assert found.expected_contrast_db is not None and best.expected_contrast_db is not None
        lost_db.append(min(best.expected_contrast_db, ENOUGH_DB) - found.expected_contrast_db)
    assert max(lost_db) < MOST_LOST_DB
    assert np.median(lost_db) < MEDIAN_LOST_DB


def test_a_level_out_of_reach_and_full_scale_are_answered_by_the_loudest_drive() -> None:
    device = DEVICES["reference-t"]
    exact, plain = designer_of(device).solver, PlainSolver(device, designer_of(device).modes)
    for felt in ([True, False], [True, True]):
        for level_db in (np.inf, 90.0):
            best, found = (each.solve([0.06, 0.21], felt, level_db) for each in (exact, plain))
            assert (found.objective, found.achieved) == ("level", best.achieved)
            assert max(found.amplitudes) == pytest.approx(device.limits.amplitude)
            assert found.weakest_felt_db > best.weakest_felt_db - MOST_LOST_DB


def test_an_actuator_is_still_outside_its_band() -> None:
    device = DEVICES["reference-a"].with_values({"actuator[1].band": ["60 Hz", "120 Hz"]})
    plain = PlainSolver(device, designer_of(DEVICES["reference-a"]).modes)
    for position_m in ([0.03, 0.2], [0.1, 0.25]):
        drive = plain.solve(position_m, [True, False], 20.0)
        assert drive.frequency_hz <= 120.0 or drive.amplitudes[0] == 0.0


@pytest.mark.parametrize("name", ["reference-a", "three actuators"])
def test_levels_and_their_spread_are_those_of_finite_elements(name: str) -> None:
    device = DEVICES[name]
    designer = designer_of(device)
    figures = designer.solve(POSITIONS_M, ROLES, 20.0)
    drive = figures.drive
    found_db = compute_levels(device, designer.modes, POSITIONS_M, drive.frequencies_hz, drive.complex_amplitudes)
    assert found_db.shape == (1 + CASES, len(POSITIONS_M)) and CASES == SAMPLES
    assert found_db[0] == pytest.approx(figures.level_db, abs=0.1)
    assert np.percentile(found_db[1:], PERCENTS, axis=0) == pytest.approx(
        np.percentile(figures.sampled_level_db, PERCENTS, axis=0), abs=0.2
    )
