"""Laws of the predicted readings: the dense model with sensor and finger assembled, and derivatives by differences."""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, Finger
from precompute.measurements.model import MeasurementModel, even_places
from precompute.measurements.parameters import find_parameters, known_names
from precompute.measurements.types import Kind, Measurements, lay_out
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import damped_as_assembly, every_device, on_each, shipped, with_actuators, with_bar
from tests.precompute.measured import NAN
from tests.precompute.model.test_transfers import with_transfers

DEVICE = with_bar(shipped("reference-a"), mass_damping_per_s=0.7)
ASSEMBLY = damped_as_assembly(DEVICE)
DEVICES = [*every_device().values(), ASSEMBLY]
any_device = on_each({device.name: device for device in DEVICES})


def rows_of(device: Device, drives_hz: Array, kind: Kind) -> Measurements:
    """Every drive at seven places with a heavy sensor; every second row has a finger on the bar."""
    rows = lay_out(drives_hz, even_places(device, 7), 2e-3, kind)
    finger_m = np.where(np.arange(len(rows)) % 2 == 0, 0.37 * device.bar.length_m, NAN)
    return replace(rows, finger_m=finger_m)


def dense_reading(device: Device, rows: Measurements, row: int) -> complex:
    """From a model with sensor and finger assembled into full matrices."""
    mass = Finger(float(rows.sensor_mass_kg[row]), 0.0, 0.0, 1.0)
    attached = [(float(rows.position_m[row]), mass)]
    if not np.isnan(rows.finger_m[row]):
        attached.append((float(rows.finger_m[row]), device.finger))
    model, place = DenseModel(device, attached), rows.position_m[row : row + 1].real
    moved = np.flatnonzero(rows.amplitude[row])
    total: complex = 0.0
    for hz in np.unique(rows.frequency_hz[row, moved]):
        weight = np.where(rows.frequency_hz[row] == hz, rows.amplitude[row], 0)
        phasor = complex(weight @ model.unit_acceleration(np.array([hz]), place)[0, 0])
        total += phasor if rows.kind is Kind.RESPONSE else abs(phasor)
    return total


@any_device
def test_readings_are_those_of_the_dense_model_with_sensor_and_finger_assembled(device: Device) -> None:
    still = [NAN] * (len(device.actuators) - 2)
    drives_hz = np.array([[150, 130, *still], [140, NAN, *still], [200, 200, *still]])
    for kind, kind_hz in ((Kind.PEAK, drives_hz), (Kind.RESPONSE, drives_hz[1:])):
        rows = rows_of(device, kind_hz, kind)
        rows = replace(rows, amplitude=rows.amplitude * np.array([0.8, 0.3 + 0.4j, *[1.0] * len(still)]))
        found = np.exp(MeasurementModel(device, rows, ()).predict(np.zeros(0)).log_acceleration)
        for row in range(0, len(rows), 5):
            assert found[row] == pytest.approx(dense_reading(device, rows, row), rel=1e-7)


def forced(device: Device, force_m: float) -> Measurements:
    """Responses per newton to a force at a place, with a heavy sensor at seven places."""
    hz = np.array([[150.0], [201.0], [66.0]]) + np.where(np.arange(len(device.actuators)) == 0, 0, NAN)
    rows = rows_of(device, hz, Kind.RESPONSE)
    return replace(rows, force_m=np.full(len(rows), force_m))


@any_device
def test_responses_per_newton_are_those_of_the_dense_model_to_one_newton(device: Device) -> None:
    rows = forced(device, 0.61 * device.bar.length_m)
    found = np.exp(MeasurementModel(device, rows, ()).predict(np.zeros(0)).log_acceleration)
    for row in range(0, len(rows), 5):
        place_m, finger_m = float(rows.position_m[row]), float(rows.finger_m[row])
        attached = [(place_m, Finger(2e-3, 0.0, 0.0, 1.0))]
        model = DenseModel(device, attached + ([] if np.isnan(finger_m) else [(finger_m, device.finger)]))
        omega, ends = 2 * np.pi * rows.frequency_hz[row, 0], model.rows([place_m, 0.61 * device.bar.length_m])
        stiffness = model.K + 1j * omega * model.C - omega**2 * model.M
        assert found[row] == pytest.approx(-(omega**2) * ends[0] @ np.linalg.solve(stiffness, ends[1]), rel=1e-7)


@pytest.mark.parametrize("device", [DEVICE, ASSEMBLY, with_transfers(DEVICE)], ids=["bar", "assembly", "transfers"])
@pytest.mark.parametrize("kind", [*Kind, "per newton"])
@pytest.mark.parametrize("name", known_names(DEVICE))
def test_derivatives_are_those_of_differences(name: str, kind: Kind | str, device: Device) -> None:
    device = with_actuators(device, clamp_m=0.018, delay_s=4e-5)
    drives_hz = np.array([[150, 130], [200, 200], [60, NAN]] if kind is Kind.PEAK else [[150, NAN], [200, 200]])
    rows = rows_of(device, drives_hz, kind) if isinstance(kind, Kind) else forced(device, 0.17)
    parameters = find_parameters(device, [name], {}, 2e-3)
    model, value = MeasurementModel(device, rows, parameters), parameters[0].start
    found = model.predict(np.array([value])).by_parameter[:, 0]
    if name.endswith({"per newton": ("full_scale", "delay"), Kind.PEAK: ("actuator.delay",)}.get(kind, ())):
        assert np.abs(found).max() < 1e-6  # per second; of others 1000/s. A delay that all share is not in peaks
        return
    step = 1e-4 / np.abs(found).max()  # changes no reading by more: beyond rounding, before anything bends
    above, below = (model.predict(np.array([value + s])).log_acceleration for s in (step, -step))
    numeric = (above - below) / (2 * step)
    tolerance = 0.03 if name.endswith("clamp") else 1e-5  # the curvature beside a clamp is that of an element
    assert np.abs(found - numeric).max() <= tolerance * np.abs(numeric).max()
