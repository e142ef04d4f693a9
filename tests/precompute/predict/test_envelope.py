"""Envelopes from rest: they rise when the rise times say, end at the steady state, and are those of the bar in time."""

import numpy as np
import pytest

from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.response import solve_response
from precompute.model.transient import TransientPlant
from precompute.predict.envelope import compute_envelopes
from precompute.predict.rise_time import compute_rise_model
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
BASIS = compute_basis(assemble(DEVICE))
FINGERS = [(0.03, DEVICE.finger), (0.2, DEVICE.finger)]
PLACE_M = np.array([0.03, 0.2])
DRIVES = {
    "one tone": (np.array([111.7, 111.7]), np.array([1.0, 0.3 - 0.2j])),
    "two tones": (np.array([208.4, 77.3]), np.array([0.2, 1.0 + 0j])),
}


@pytest.mark.parametrize("name", DRIVES)
def test_they_end_at_the_steady_state(name: str) -> None:
    frequency_hz, amplitude = DRIVES[name]
    model = compute_rise_model(BASIS, [FINGERS], PLACE_M[None])
    tones_hz, envelope = compute_envelopes(model, frequency_hz, amplitude, np.array([0.0, 20.0]))
    plant = assemble(DEVICE).with_fingers(PLACE_M.tolist(), DEVICE.finger)
    field = solve_response(plant, tones_hz).acceleration(PLACE_M)
    weight = np.where(frequency_hz == tones_hz[:, None], amplitude, 0)
    assert envelope[:, 0, :, 1] == pytest.approx(abs(np.einsum("ta,tap->tp", weight, field)), rel=2e-3)


def test_they_are_the_magnitude_of_what_the_bar_does_in_time() -> None:
    frequency_hz, amplitude = DRIVES["one tone"]
    rate_hz = 48_000.0
    time_s = np.arange(1, 2400) / rate_hz
    turning = np.exp(2j * np.pi * frequency_hz[0] * time_s)[:, None] * amplitude
    parts = []
    for displacement in (turning.real, turning.imag):
        plant = TransientPlant(BASIS, PLACE_M, rate_hz)
        plant.touch(FINGERS)
        parts.append(plant.run(displacement)[0])
    in_time = abs(parts[0] + 1j * parts[1]).T
    model = compute_rise_model(BASIS, [FINGERS], PLACE_M[None])
    _, envelope = compute_envelopes(model, frequency_hz, amplitude, time_s)
    settled = time_s > 0.005  # a step of the base at t = 0 rings in modes that 48 kHz hardly resolve
    assert np.median(abs(in_time / envelope[0, 0] - 1)[:, settled]) < 0.02
