"""Laws of rise times: as brute force on the dense model and on the bar in time, fingers included, blind to level."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, Finger
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.predict.envelope import compute_envelopes
from precompute.predict.rise_time import LONGEST_RISE_S, WITHIN, compute_rise_model, compute_rise_time
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import other_bars, shipped, with_bar
from tests.quick import first_quick

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Fingers = list[tuple[float, Finger]]
STEP_S = 5e-5
"""Steps of the brute force: 1/40 of the fastest beat at 250 Hz."""
DRIVES = {
    "coherent": ((111.7, 111.7), (1.0, 0.09)),
    "one alone": ((141.2, 141.2), (0.0, 1.0)),
    "coherent, opposed": ((300.0, 300.0), (1.0, -0.16)),
    "two tones": ((208.4, 77.3), (0.2, 1.0)),
}


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


def assert_between(found: Array, course: Array, final: Array) -> None:
    """Each t90 is one of a band that is 2 % wider or narrower; course (place, time) at multiples of STEP_S."""
    for rise_s, envelope, steady in zip(found, course, final, strict=True):
        least, most = (last_outside(envelope, steady, STEP_S, WITHIN * margin) for margin in (1.02, 0.98))
        assert least - STEP_S <= rise_s <= most + STEP_S


LIGHT, DAMPED = shipped("reference-a"), shipped("reference-d")
QUICK = [(DAMPED, drive, True) for drive in DRIVES]
"""On the light bar what is there after 1.5 s takes most of the time."""


@pytest.mark.parametrize(
    ("device", "drive", "touched"),
    [
        pytest.param(*case, id=f"{case[0].name}-{case[1]}-{case[2]}", marks=[] if case in QUICK else [pytest.mark.long])
        for case in product((LIGHT, DAMPED), DRIVES, (False, True))
    ],
)
def test_t90_is_the_time_after_which_the_acceleration_stays_within_a_tenth(
    device: Device, drive: str, touched: bool
) -> None:
    fingers, places_m = fingers_on(device) if touched else [], places_on(device)
    time_s = STEP_S * np.arange(round(1.5 / STEP_S), dtype=np.float64)
    course, final = DenseModel(device, fingers).envelope(*drive_of(drive), places_m, time_s)
    assert_between(rise_times(device, fingers, drive, places_m), course.T, final)


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


ANY_BAR = {name: shipped(name) for name in ("reference-a", "reference-t")} | {
    "acrylic": other_bars()["acrylic 500 x 0.8 mm"]
}


@pytest.mark.parametrize("top_hz", [300.0, 500.0, 1000.0])
@pytest.mark.parametrize("device", first_quick(ANY_BAR.values()), ids=ANY_BAR)
def test_no_excursion_between_two_looks_is_missed(device: Device, top_hz: float) -> None:
    """Random drives of one and two tones, against their envelopes every 50 us."""
    random = np.random.default_rng(round(top_hz))
    places_m = random.uniform(0.0, device.bar.length_m, 4)
    model = compute_rise_model(basis_of(device), [[(at, device.finger) for at in places_m[:2]]], places_m[None])
    time_s, count = np.append(STEP_S * np.arange(round(1.0 / STEP_S)), 1e3), len(device.actuators)
    for tones in (1, 2) * 4:
        hz = np.resize(random.uniform(60.0, top_hz, tones), count)
        amplitude = random.normal(size=count) + 1j * random.normal(size=count)
        course = compute_envelopes(model, hz, amplitude, time_s)[1].sum(axis=0)[0]
        found = compute_rise_time(model, hz, amplitude)[0]
        followed = found < 0.9
        assert_between(found[followed], course[followed, :-1], course[followed, -1])


def lightly_damped(factor: float) -> Device:
    """Reference-a with these fractions of its dampings."""
    device = with_bar(shipped("reference-a"), mass_damping_per_s=0.0, stiffness_damping_s=5.00456e-5 * factor)
    actuators = tuple(replace(one, damping_n_s_per_m=0.045 * factor) for one in device.actuators)
    return replace(device, actuators=actuators)


def test_the_rise_time_grows_as_damping_falls_until_it_is_cut_off() -> None:
    hz, amplitude = np.array([75.0, 75.0]), np.array([1.0, 0.0], dtype=np.complex128)
    models = [compute_rise_model(basis_of(lightly_damped(f)), [[]], np.array([[0.03]])) for f in (1.0, 0.3, 0.1, 0.01)]
    found = [float(compute_rise_time(model, hz, amplitude)[0, 0]) for model in models]
    assert found[0] < found[1] < found[2] < LONGEST_RISE_S == found[3]
