"""Law of envelopes from rest: they are those of the dense model, and end at its steady state."""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, Finger
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.predict.envelope import compute_envelopes
from precompute.predict.rise_time import compute_rise_model
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import shipped
from tests.quick import first_quick

DRIVES = {
    "coherent": ((111.7, 111.7), (1.0, 0.3 - 0.2j)),
    "one alone": ((141.2, 141.2), (0.0, 1.0)),
    "coherent, opposed": ((300.0, 300.0), (1.0, -0.16)),
    "two tones": ((208.4, 77.3), (0.2, 1.0)),
}
SHARPEST_S = 5e-3
"""The step of the bases at t = 0 rings for that long in modes above the band, which envelopes leave out."""


def fingers_on(device: Device) -> list[tuple[float, Finger]]:
    heavy = replace(device.finger, mass_kg=3e-4, damping_n_s_per_m=0.5)
    return [(0.1 * device.bar.length_m, device.finger), (0.7 * device.bar.length_m, heavy)]


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("name", first_quick(["reference-d", "reference-a"]))
@pytest.mark.parametrize("touched", [True, False])
def test_they_are_those_of_the_dense_model(name: str, drive: str, touched: bool) -> None:
    device, (hz, amplitude) = shipped(name), map(np.array, DRIVES[drive])
    fingers, places_m = fingers_on(device) if touched else [], np.array([0.1, 0.45, 0.92]) * device.bar.length_m
    time_s = np.arange(0.0, 0.2, 5e-4)
    course, final = DenseModel(device, fingers).envelope(hz, amplitude, places_m, time_s)
    model = compute_rise_model(compute_basis(assemble(device)), [fingers], places_m[None])
    _, envelope = compute_envelopes(model, hz, amplitude.astype(np.complex128), np.append(time_s, 1e3))
    found: Array = envelope.sum(axis=0)[0].T
    assert found[-1] == pytest.approx(final, rel=2e-3)
    error = abs(found[:-1] - course)[time_s > SHARPEST_S] / final
    assert error.max() <= 0.01
