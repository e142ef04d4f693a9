"""Laws of inertial actuators, on bars and plates: a great mass is the ground, a small one what a formula says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from base.arrays import Complex, Points
from engine.device import Device
from precompute.model.assembly import assemble, assemble_bar
from precompute.model.modal_plant import ModalPlant
from precompute.model.plant import Plant
from precompute.model.response import blocked_force, solve_response
from tests.precompute.devices import random_device, shipped, tablet, with_inertial

HZ = np.array([61.0, 118.0, 123.3, 187.0, 300.0])
on_both = pytest.mark.parametrize(
    "device", [shipped("reference-a"), random_device(7), tablet()], ids=lambda device: device.name
)


def points_of(device: Device) -> Points:
    return np.array([0.12, 0.4, 0.83]) * device.surface.corner_m


@cache
def plant_of(device: Device) -> Plant:
    return assemble(device)


def driven(device: Device) -> Complex:
    """Displacement (frequency, actuator, point) at full scale, with a finger."""
    points_m = points_of(device)
    plant = plant_of(device).with_fingers(points_m[:1].tolist(), device.finger)
    return plant.sampler(points_m).sample(solve_response(plant, HZ).displacement_m)


@on_both
def test_on_a_great_moving_mass_an_actuator_is_grounded(device: Device) -> None:
    forces = tuple(replace(actuator, is_force=True) for actuator in device.actuators)
    grounded = replace(device, actuators=forces)
    inertial = replace(device, actuators=tuple(replace(each, moving_mass_kg=1e4) for each in forces))
    expected = driven(grounded)
    assert abs(driven(inertial) - expected).max() < 1e-3 * abs(expected).max()


@on_both
def test_a_moving_mass_is_the_dynamic_stiffness_and_the_force_that_are_left_when_it_is_eliminated(
    device: Device,
) -> None:
    """I (k + c s) / (I + c s + k) at the place, and F I / (I + c s + k), I = M (s^2 + sigma s)."""
    device = with_inertial(device)
    first = device.actuators[0]
    assert first.moving_mass_kg is not None
    own = replace(first, stiffness_n_per_m=1e-6, damping_n_s_per_m=0.0, moving_mass_kg=None)
    bare = plant_of(replace(device, actuators=(own, *device.actuators[1:])))
    finger = bare.with_fingers(points_of(device)[:1].tolist(), device.finger)
    points_m = np.concatenate([[first.position_m], points_of(device)])
    receptance = finger.sampler(points_m).sample(solve_response(finger, HZ, points_m).displacement_m)
    at_own = receptance[:, len(device.actuators)]  # of a force at the place: (frequency, point)
    s = 2j * np.pi * HZ
    spring, inertia = (
        first.stiffness_n_per_m + s * first.damping_n_s_per_m,
        (s**2 + s * device.surface.mass_damping_per_s) * first.moving_mass_kg,
    )
    left, force = inertia * spring / (inertia + spring), first.spring_force_n * inertia / (inertia + spring)
    left += s * device.surface.mass_damping_per_s * first.mass_kg
    expected = (force / (1 + left * at_own[:, 0]))[:, None] * at_own[:, 1:]
    tolerance = 1e-6 if isinstance(device.surface.corner_m, float) else 2e-3  # 150 modes stand for a plate
    assert abs(driven(device)[:, 0] - expected).max() < tolerance * abs(expected).max()


@on_both
def test_what_a_point_gets_of_an_actuators_force_the_actuator_gets_of_a_force_at_the_point(device: Device) -> None:
    """The force acts on surface and moving mass, so what it gets is the motion of one relative to the other."""
    plant, points_m, count = plant_of(with_inertial(device)), points_of(device), len(device.actuators)
    field = solve_response(plant, HZ, points_m).displacement_m
    force = blocked_force(plant.device.actuators, HZ)
    driven = plant.sampler(points_m).sample(field[:, :count]) / force[..., None]
    stretched = plant.actuators.sample(field[:, count:])
    assert abs(driven - stretched.swapaxes(1, 2)).max() < 1e-9 * abs(driven).max()


def test_fields_and_integrals_of_modes_of_finite_elements_are_those_of_the_banded_bar() -> None:
    device = shipped("reference-t")
    plant = plant_of(with_inertial(device))
    assert isinstance(plant, ModalPlant)
    banded = assemble_bar(device)
    field = np.random.default_rng(3).normal(size=(1, 2, plant.size)).astype(np.complex128)
    points_m = np.sort(np.random.default_rng(4).uniform(0, device.bar.length_m, 9))
    shaped: Complex = field @ plant.shape.T.astype(np.complex128)
    assert plant.sampler(points_m).sample(field) == pytest.approx(banded.sampler(points_m).sample(shaped))
    assert plant.gram(field) == pytest.approx(banded.gram(shaped), rel=1e-7, abs=1e-9)
    assert plant.zone_places_m == pytest.approx(banded.zone_places_m)
