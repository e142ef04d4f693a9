"""Laws of modes at places: they move as the plant does at any point, with fingers too, on bars and plates."""

from collections.abc import Sequence

import numpy as np
import pytest

from base.arrays import Array, Points
from engine.device import Device, Finger
from engine.steady.cases import FingerCases, axes_of, cases_at, sample_deviations
from engine.steady.steady_drive import PlainLoading
from engine.steady.steady_solver import SteadySolver
from precompute.model.assembly import assemble
from precompute.model.plant import Plant
from precompute.model.response import solve_response
from precompute.sampling.steady_modes import steady_basis, steady_modes
from tests.precompute.devices import every_device, shipped, tablet, with_inertial

FREQUENCY_HZ = np.array([61.0, 148.3, 290.0])
PLATE = tablet()
INERTIAL = with_inertial(shipped("reference-a")), with_inertial(PLATE)
TOLERANCE_DB = 0.05


def random_points(device: Device, count: int, seed: int = 1) -> Points:
    corner_m, random = device.surface.corner_m, np.random.default_rng(seed)
    x, y = random.uniform(0.02, 0.98, (2, count))
    return np.asarray(x * corner_m.real + 1j * y * corner_m.imag if isinstance(corner_m, complex) else x * corner_m)


@pytest.mark.parametrize("device", [*every_device().values(), PLATE, *INERTIAL], ids=lambda device: device.name)
def test_drives_and_receptances_between_places_are_those_of_the_plant(device: Device) -> None:
    plant, points_m = assemble(device), random_points(device, 5)
    loading = PlainLoading(modes := steady_modes(steady_basis(plant), FREQUENCY_HZ))
    exact = plant.sampler(points_m).sample(solve_response(plant, FREQUENCY_HZ, points_m).displacement_m)
    actuators = len(device.actuators)
    drive = loading.untouched(points_m) / modes.per_threshold[:, None]
    point = loading.receptances(points_m, points_m)
    assert abs(drive.transpose(1, 2, 0) - exact[:, :actuators]).max() < 1e-3 * abs(exact[:, :actuators]).max()
    assert abs(point - exact[:, actuators:]).max() < 2e-3 * abs(exact[:, actuators:]).max()
    assert np.allclose(point, point.swapaxes(1, 2), rtol=1e-9)


@pytest.mark.parametrize("fingers", [1, 2, 4])
def test_fingers_on_a_plate_feel_what_the_loaded_plant_says(fingers: int) -> None:
    plant, points_m = assemble(PLATE), random_points(PLATE, fingers, seed=fingers)
    solver = SteadySolver(PLATE, steady_modes(steady_basis(plant), PLATE.sweep.frequency_hz))
    felt = [finger == 0 for finger in range(fingers)]
    drive = solver.solve(points_m.tolist(), felt, 14.0)
    told_db = np.concatenate([drive.level_db[None], drive.sampled_level_db])
    corner_m = PLATE.surface.corner_m
    deviations = sample_deviations(fingers, len(drive.sampled_level_db), axes_of(corner_m))
    hz, amplitude = np.array([drive.frequency_hz]), np.array(drive.complex_amplitudes)
    exact_db = levels_db(plant, cases_at(points_m, deviations, PLATE), hz, amplitude)
    heard = exact_db > exact_db.max() - 20
    assert drive.frequency_hz in PLATE.sweep.frequency_hz
    assert drive.achieved and abs(told_db - exact_db)[heard].max() < TOLERANCE_DB
    if fingers > 1:
        assert contrast_db(exact_db, felt) == pytest.approx(drive.value, abs=TOLERANCE_DB)


def levels_db(plant: Plant, cases: FingerCases, hz: Array, amplitude: Points) -> Array:
    rows = []
    for position_m, impedance in zip(cases.position_m, cases.impedance, strict=True):
        fingers = [Finger(mass_kg=m, damping_n_s_per_m=c, stiffness_n_per_m=k, spread=1.0) for k, c, m in impedance]
        loaded = plant.with_fingers(position_m.tolist(), fingers)
        rows.append(abs(amplitude @ solve_response(loaded, hz).acceleration(position_m)[0]))
    return np.asarray(20 * np.log10(np.array(rows) / plant.device.threshold.peak_m_per_s2(hz)))


def contrast_db(level_db: Array, felt: Sequence[bool]) -> float:
    mean, is_felt = (10 ** (level_db[1:] / 10)).mean(axis=0), np.array(felt)
    return float(10 * np.log10(mean[is_felt].min() / mean[~is_felt].max()))
