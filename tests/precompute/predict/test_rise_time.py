"""Laws of rise times: as brute force on the envelopes, which are those of the dense model."""

from functools import cache

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.predict.rise_time import WITHIN, compute_envelopes, compute_rise_model, compute_rise_time
from tests.precompute.devices import other_bars, shipped
from tests.quick import first_quick

STEP_S = 5e-5
"""Steps of the brute force: 1/40 of the fastest beat at 250 Hz."""


@cache
def basis_of(device: Device) -> Basis:
    return compute_basis(assemble(device))


def assert_between(found: Array, course: Array, final: Array) -> None:
    """Each t90 is one of a band that is 2 % wider or narrower; course (place, time) at multiples of STEP_S."""
    for rise_s, envelope, steady in zip(found, course, final, strict=True):
        outside = (np.flatnonzero(abs(envelope / steady - 1) > WITHIN * margin)[-1] for margin in (1.02, 0.98))
        least_s, most_s = ((last + 1) * STEP_S for last in outside)
        assert least_s - STEP_S <= rise_s <= most_s + STEP_S


ANY_BAR = {name: shipped(name) for name in ("reference-a", "reference-t")} | {
    "acrylic": other_bars()["acrylic 500 x 0.8 mm"]
}


@pytest.mark.parametrize("top_hz", [300.0, 500.0, 1000.0])
@pytest.mark.parametrize("device", first_quick(ANY_BAR.values()), ids=ANY_BAR)
def test_no_excursion_between_two_looks_is_missed(device: Device, top_hz: float) -> None:
    """Random drives of one and two tones, against their envelopes every 50 us."""
    random = np.random.default_rng(round(top_hz))
    places_m = random.uniform(0.0, device.bar.length_m, 4)
    model = compute_rise_model(basis_of(device), [(at, device.finger) for at in places_m[:2]], places_m)
    time_s, count = np.append(STEP_S * np.arange(round(1.0 / STEP_S)), 1e3), len(device.actuators)
    for tones in (1, 2) * 4:
        hz = np.resize(random.uniform(60.0, top_hz, tones), count)
        amplitude = random.normal(size=count) + 1j * random.normal(size=count)
        course = compute_envelopes(model, hz, amplitude, time_s)[1].sum(axis=0)
        found = compute_rise_time(model, hz, amplitude)
        followed = found < 0.9
        assert_between(found[followed], course[followed, :-1], course[followed, -1])
