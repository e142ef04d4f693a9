"""Laws of the bar in time: steady state equals the frequency response, chunks do not matter, free motion decays."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, Finger
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant
from tests.precompute.dense_model import DenseModel, drive_of
from tests.precompute.devices import every_device, on_each, shipped, with_bar
from tests.quick import first_quick

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
RATE_HZ = 48000.0
DEVICES = {device.name: with_bar(device, mass_damping_per_s=20.0) for device in every_device().values()}
"""Damped, so that a second and a half from rest all is steady to 1e-6; the laws do not depend on it."""
any_device = on_each(DEVICES)


def fingers_on(device: Device) -> list[tuple[float, Finger]]:
    return [(0.11 * device.bar.length_m, device.finger), (0.6 * device.bar.length_m, device.finger)]


def points_of(device: Device) -> Array:
    return np.linspace(0, device.bar.length_m, 22)


@cache
def basis_of(device: Device) -> Basis:
    return compute_basis(assemble(device))


def plant_of(device: Device) -> TransientPlant:
    return TransientPlant(basis_of(device), points_of(device), RATE_HZ)


def tones(frequency_hz: Array, amplitude: Complex, seconds: float) -> Array:
    """Base displacements (time, actuator), cosines of these amplitudes; the first sample is one step after t = 0."""
    time_s = np.arange(1, round(seconds * RATE_HZ) + 1) / RATE_HZ
    waves: Array = (amplitude * np.exp(2j * np.pi * np.outer(time_s, frequency_hz))).real
    return waves


@cache
def settled(device: Device, touched: bool, coherent: bool) -> tuple[Array, Array]:
    """Acceleration and zone energies of the second after the first one and a half, of `drive_of`."""
    plant, (hz, amplitude) = plant_of(device), drive_of(device, coherent)
    plant.touch(fingers_on(device) if touched else [])
    waves = tones(hz, amplitude, 2.5)
    plant.run(waves[: round(1.5 * RATE_HZ)])
    return plant.run(waves[round(1.5 * RATE_HZ) :])


@any_device
@pytest.mark.parametrize("coherent", [True, False])
@pytest.mark.parametrize("touched", [True, False])
def test_steady_state_equals_the_frequency_response(device: Device, coherent: bool, touched: bool) -> None:
    fingers = fingers_on(device) if touched else []
    hz, amplitude = drive_of(device, coherent)
    acceleration, _ = settled(device, touched, coherent)
    unit = DenseModel(device, fingers).unit_acceleration(np.unique(hz), points_of(device))
    time_s = (1.5 * RATE_HZ + np.arange(1, len(acceleration) + 1)) / RATE_HZ
    rest = acceleration.copy()
    for tone, there in zip(np.unique(hz), unit, strict=True):
        turning = np.exp(2j * np.pi * tone * time_s)
        found, right = 2 * (turning.conj() @ acceleration) / len(time_s), there @ np.where(hz == tone, amplitude, 0)
        assert abs(found - right).max() <= 1e-3 * abs(right).max()
        rest -= (turning[:, None] * found).real
    assert abs(rest).max() <= 1e-3 * abs(acceleration).max()


@any_device
@pytest.mark.parametrize("coherent", [True, False])
@pytest.mark.parametrize("touched", [True, False])
def test_zone_energies_are_integrals_of_the_velocity_squared(device: Device, coherent: bool, touched: bool) -> None:
    """Over a second, in which tones of different frequencies add as energies: paper eq. (10) before it is a ratio."""
    model, (hz, amplitude) = DenseModel(device, fingers_on(device) if touched else []), drive_of(device, coherent)
    tones_hz = np.unique(hz)
    weight = np.where(hz == tones_hz[:, None], amplitude, 0)
    grams = np.stack([model.unit_gram(tones_hz, zone.start_m, zone.stop_m) for zone in device.zones])
    expected = np.einsum("ta,ztab,tb->z", weight.conj(), grams, weight).real / 2
    _, energy = settled(device, touched, coherent)
    assert energy == pytest.approx(expected, rel=2e-3, abs=1e-6 * expected.sum())


@pytest.fixture(scope="module")
def whole_run() -> tuple[Array, Array, Array]:
    """Waves, and the accelerations and energies of the bar that they move in one stretch."""
    waves = np.random.default_rng(0).normal(size=(8241, 2))
    return waves, *plant_of(shipped("reference-a")).run(waves)


@pytest.mark.parametrize(
    "pieces",
    first_quick([[17, 8224], [8192, 49], [1] * 50 + [8191], [3000, 5241], [8193, 48]]),
)
def test_stretches_do_not_matter(whole_run: tuple[Array, Array, Array], pieces: list[int]) -> None:
    waves, whole, energy = whole_run
    plant = plant_of(shipped("reference-a"))
    parts = [plant.run(part) for part in np.split(waves, np.cumsum(pieces)[:-1])]
    scale = abs(whole).max()
    assert np.concatenate([part for part, _ in parts]) == pytest.approx(whole, rel=1e-9, abs=1e-9 * scale)
    assert sum(part for _, part in parts) == pytest.approx(energy, rel=1e-9)


def test_a_bar_at_rest_again_repeats_itself_at_any_rate_of_steps() -> None:
    """`accelerate` is `run` without energies; after `rest`, steps three times as fine give the same courses."""
    device = shipped("reference-a")
    plant, waves = plant_of(device), np.random.default_rng(2).normal(size=(400, 2))
    waves[0] = 0.0
    first = plant.run(waves)[0]
    plant.rest()
    assert plant.accelerate(waves).tobytes() == first.tobytes()
    plant.rest()
    plant.sample_rate_hz *= 3
    at = np.arange(3 * len(waves) - 2) / 3
    finer = plant.accelerate(np.column_stack([np.interp(at, np.arange(len(waves)), wave) for wave in waves.T]))
    assert finer[::3] == pytest.approx(first, rel=1e-6, abs=1e-6 * abs(first).max())


def test_a_finger_that_comes_and_goes_leaves_the_steady_state_of_the_bar_alone() -> None:
    device = DEVICES["reference-a"]
    hz, amplitude = drive_of(device, coherent=True)
    waves, plant = tones(hz, amplitude, 3.0), plant_of(device)
    plant.run(waves[:24000])
    plant.touch(fingers_on(device))
    plant.run(waves[24000:48000])
    plant.touch(())
    plant.run(waves[48000:-9600])
    again, _ = plant.run(waves[-9600:])
    never, _ = settled(device, touched=False, coherent=True)
    assert abs(again).max(axis=0) == pytest.approx(abs(never).max(axis=0), rel=1e-3)
