"""Laws of rise times: as brute force on the dense model and on the bar in time, fingers included, blind to level."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, Finger
from precompute.entries.rise_time import LONGEST_S, STEP_S, WITHIN, compute_rise_model, compute_rise_time
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import shipped, with_bar

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Fingers = list[tuple[float, Finger]]
both_devices = pytest.mark.parametrize("device", [shipped("reference-a"), shipped("reference-d")], ids=["A", "D"])
DRIVES = {
    "coherent": ((111.7, 111.7), (1.0, 0.09)),
    "one alone": ((141.2, 141.2), (0.0, 1.0)),
    "coherent, opposed": ((300.0, 300.0), (1.0, -0.16)),
    "two tones": ((208.4, 77.3), (0.2, 1.0)),
}
any_drive = pytest.mark.parametrize("drive", DRIVES)


@cache
def basis_of(device: Device) -> Basis:
    return compute_basis(assemble(device))


def fingers_on(device: Device) -> Fingers:
    heavy = replace(device.finger, mass_kg=3e-4, damping_n_s_per_m=0.5)
    return [(0.1 * device.bar.length_m, device.finger), (0.7 * device.bar.length_m, heavy)]


def rise_times(device: Device, fingers: Fingers, drive: str, places_m: Array) -> Array:
    frequency_hz, amplitude = drive_of(drive)
    model = compute_rise_model(basis_of(device), [fingers], places_m[None])
    found: Array = compute_rise_time(model, frequency_hz, amplitude)[0]
    return found


def drive_of(name: str) -> tuple[Array, Complex]:
    hz, amplitude = DRIVES[name]
    return np.array(hz), np.array(amplitude, dtype=np.complex128)


def places_on(device: Device) -> Array:
    return np.array([0.03, 0.1, 0.45, 0.92]) * device.bar.length_m


def last_outside(envelope: Array, final: float, step_s: float, within: float = WITHIN) -> float:
    """The time after which it stays within; envelope[k] is at k steps."""
    outside = np.flatnonzero(abs(envelope - final) > within * final)
    return float((outside[-1] + 1) * step_s)


@both_devices
@any_drive
@pytest.mark.parametrize("touched", [False, True])
def test_t90_is_the_time_after_which_the_acceleration_stays_within_a_tenth(
    device: Device, drive: str, touched: bool
) -> None:
    fingers, places_m = fingers_on(device) if touched else [], places_on(device)
    time_s = STEP_S * np.arange(6000.0)
    course, final = DenseModel(device, fingers).envelope(*drive_of(drive), places_m, time_s)
    expected = [last_outside(*place, STEP_S) for place in zip(course.T, final, strict=True)]
    assert rise_times(device, fingers, drive, places_m) == pytest.approx(expected, rel=0.02, abs=2 * STEP_S)


@both_devices
@pytest.mark.parametrize("drive", ["coherent", "two tones"])
def test_the_bar_in_time_under_fingers_rises_as_long(device: Device, drive: str) -> None:
    """TransientPlant knows nothing of rise times. Between steps an excursion of 7 % over the tenth may be missed."""
    rate_hz, (frequency_hz, amplitude), places_m = 24000.0, drive_of(drive), places_on(device)
    time_s = np.arange(1, round(1.5 * rate_hz) + 1) / rate_hz
    total = np.zeros((len(time_s), len(places_m)))
    for hz in np.unique(frequency_hz[amplitude != 0]):
        weight = np.where(frequency_hz == hz, amplitude, 0)
        turning = np.exp(2j * np.pi * hz * time_s)[:, None]
        parts = []  # of exp(j omega t): from a base already out there, as the cosine starts, and from one at 0
        for start, wave in ((weight.real, (weight * turning).real), (weight.imag, (weight * turning).imag)):
            plant = TransientPlant(basis_of(device), places_m, rate_hz)
            plant.touch(fingers_on(device))
            plant._last = start
            parts.append(plant.run(wave)[0])
        total += np.hypot(*parts)
    final = total[-200:].mean(axis=0)
    found = rise_times(device, fingers_on(device), drive, places_m)
    for envelope, steady, rise_s in zip(total.T, final, found, strict=True):
        least, most = (last_outside(envelope, steady, 1 / rate_hz, WITHIN * (1 + margin)) for margin in (0.08, -0.02))
        assert least - 2 * STEP_S <= rise_s <= most + 2 * STEP_S


def test_rise_does_not_depend_on_the_level() -> None:
    device = shipped("reference-a")
    model = compute_rise_model(basis_of(device), [[]], np.array([[0.01, 0.2]]))
    frequency_hz, amplitude = np.array([111.7, 230.0]), np.array([0.5, 1j], dtype=np.complex128)
    one, other = (compute_rise_time(model, frequency_hz, drive) for drive in (amplitude, amplitude / 1000))
    assert one == pytest.approx(other)


def test_every_touch_rises_as_it_does_alone() -> None:
    device = shipped("reference-d")
    cases: list[Fingers] = [[], fingers_on(device), fingers_on(device)[:1]]
    places_m = np.array([[0.02, 0.1], [0.03, 0.2], [0.15, 0.05]])
    frequency_hz, amplitude = drive_of("two tones")
    together = compute_rise_time(compute_rise_model(basis_of(device), cases, places_m), frequency_hz, amplitude)
    for case, places, found in zip(cases, places_m, together, strict=True):
        model = compute_rise_model(basis_of(device), [case], places[None])
        assert compute_rise_time(model, frequency_hz, amplitude)[0] == pytest.approx(found)


def test_a_finger_makes_a_light_bar_rise_sooner() -> None:
    device, places_m = shipped("reference-a"), np.array([0.03])
    bare = rise_times(device, [], "coherent", places_m)
    touched = rise_times(device, [(0.03, device.finger)], "coherent", places_m)
    assert touched[0] < 0.6 * bare[0]


def test_what_hardly_decays_is_followed_for_ten_seconds() -> None:
    device = with_bar(shipped("reference-a"), mass_damping_per_s=0.0, stiffness_damping_s=0.0)
    device = replace(device, actuators=tuple(replace(one, damping_n_s_per_m=1e-4) for one in device.actuators))
    found = rise_times(device, [], "coherent", places_on(device))
    assert (found > 5.0).all() and (found <= LONGEST_S + STEP_S).all()
