"""Laws of the bar in time: steady state equals the frequency response, chunks do not matter, free motion decays."""

from functools import cache

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, Finger
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant
from tests.precompute.dense_model import DenseModel, drive_of
from tests.precompute.devices import every_device, on_each, shipped, with_bar

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


@any_device
@pytest.mark.parametrize("coherent", [True, False])
@pytest.mark.parametrize("touched", [True, False])
def test_a_second_of_the_steady_state_equals_the_frequency_response(
    device: Device, coherent: bool, touched: bool
) -> None:
    """Of the second after the first one and a half; zone energies are integrals of the velocity squared over it.

    In it tones of different frequencies add as energies: paper eq. (10) before it is a ratio.
    """
    plant, (hz, amplitude) = plant_of(device), drive_of(device, coherent)
    fingers = fingers_on(device) if touched else []
    plant.touch(fingers)
    # The first sample is one step after t = 0.
    time_s = np.arange(1, round(2.5 * RATE_HZ) + 1) / RATE_HZ
    begin_s, time_s = np.split(time_s, [round(1.5 * RATE_HZ)])
    plant.run((amplitude * np.exp(2j * np.pi * np.outer(begin_s, hz))).real)
    acceleration, energy = plant.run((amplitude * np.exp(2j * np.pi * np.outer(time_s, hz))).real)
    model, tones_hz = DenseModel(device, fingers), np.unique(hz)
    weight = np.where(hz == tones_hz[:, None], amplitude, 0)
    unit, rest = model.unit_acceleration(tones_hz, points_of(device)), acceleration.copy()
    for tone, there, of_tone in zip(tones_hz, unit, weight, strict=True):
        turning = np.exp(2j * np.pi * tone * time_s)
        found, right = 2 * (turning.conj() @ acceleration) / len(time_s), there @ of_tone
        assert abs(found - right).max() <= 1e-3 * abs(right).max()
        rest -= (turning[:, None] * found).real
    assert abs(rest).max() <= 1e-3 * abs(acceleration).max()
    grams = np.stack([model.unit_gram(tones_hz, zone.start_m.real, zone.stop_m.real) for zone in device.zones])
    expected = np.einsum("ta,ztab,tb->z", weight.conj(), grams, weight).real / 2
    assert energy == pytest.approx(expected, rel=2e-3, abs=1e-6 * expected.sum())


def test_stretches_do_not_matter() -> None:
    waves, plant = np.random.default_rng(0).normal(size=(8_400, 2)), plant_of(shipped("reference-a"))
    whole, energy = plant.run(waves)
    plant.rest()
    parts = [plant.run(part) for part in np.split(waves, [1, 2, 19, 8211, 8260])]
    scale = abs(whole).max()
    assert np.concatenate([part for part, _ in parts]) == pytest.approx(whole, rel=1e-9, abs=1e-9 * scale)
    assert sum(part for _, part in parts) == pytest.approx(energy, rel=1e-9)


@any_device
def test_blocks_of_samples_move_the_bar_as_sample_after_sample_does(device: Device) -> None:
    plant = plant_of(device)
    waves = np.random.default_rng(3).normal(size=(8_400, len(device.actuators)))
    plant.touch(fingers_on(device))
    whole = plant.run(waves)[0]
    plant.rest()
    found = [plant.accelerate(part) for part in np.split(waves, [0, 33, 8230, 8231, 8263])]
    assert np.concatenate(found) == pytest.approx(whole, rel=1e-9, abs=1e-9 * abs(whole).max())
    plant.touch(())
    after = plant.accelerate(waves)
    plant.rest()
    plant.touch(fingers_on(device))
    plant.run(waves)
    plant.touch(())
    assert after == pytest.approx(plant.run(waves)[0], rel=1e-9, abs=1e-9 * abs(whole).max())


def test_a_bar_at_rest_again_repeats_itself_at_any_rate_of_steps() -> None:
    """After `rest` steps three times as fine give the same courses."""
    device = shipped("reference-a")
    plant, waves = plant_of(device), np.random.default_rng(2).normal(size=(400, 2))
    waves[0] = 0.0
    first = plant.accelerate(waves)
    plant.rest()
    assert plant.accelerate(waves).tobytes() == first.tobytes()
    finer_plant = TransientPlant(basis_of(device), points_of(device), 3 * RATE_HZ)
    at = np.arange(3 * len(waves) - 2) / 3
    finer = finer_plant.accelerate(np.column_stack([np.interp(at, np.arange(len(waves)), wave) for wave in waves.T]))
    assert finer[::3] == pytest.approx(first, rel=1e-6, abs=1e-6 * abs(first).max())
