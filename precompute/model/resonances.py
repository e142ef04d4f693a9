"""The plant to frequencies at which it hides nothing: its sweep, finer, and every narrow resonance between."""

import numpy as np
from numpy.typing import NDArray

from precompute.entries.candidate import on_the_wire
from precompute.model.assembly import Plant
from precompute.model.modal import compute_basis, compute_modal_model

Array = NDArray[np.float64]

_PARTS = 4
"""Of a step of the sweep."""
_NARROW = 3.0
"""Resonances with a half bandwidth under so many of these parts get frequencies of their own."""
_CLUSTER = np.sinh(np.linspace(-2.2, 2.2, 9))
"""Distances from a narrow resonance in half bandwidths: the greatest response is missed by 0.1 dB at most."""


def fine_frequencies(plant: Plant) -> Array:
    """Shape (frequency,), rising, within the sweep of the device, on the steps of the wire, band edges included."""
    device, sweep = plant.device, plant.device.sweep
    part_hz = sweep.step_hz / _PARTS
    count = round((sweep.stop_hz - sweep.start_hz) / part_hz) + 1
    even = np.linspace(sweep.start_hz, sweep.stop_hz, count)
    pole = compute_modal_model(compute_basis(plant)).pole
    half_hz, centre_hz = -pole.real / (2 * np.pi), pole.imag / (2 * np.pi)
    narrow = (pole.imag > 0) & (half_hz < _NARROW * part_hz)
    own = (centre_hz[narrow, None] + half_hz[narrow, None] * _CLUSTER).ravel()
    edges = np.array([edge for actuator in device.actuators for edge in actuator.band_hz])
    extra = np.concatenate([own, edges])
    inside = extra[(extra > sweep.start_hz) & (extra < sweep.stop_hz)]
    return np.unique(on_the_wire(np.concatenate([even, inside])))


def in_band(plant: Plant, frequency_hz: Array) -> NDArray[np.bool_]:
    """Shape (frequency, actuator): whether an actuator may play a frequency."""
    bands = np.array([actuator.band_hz for actuator in plant.device.actuators])
    slack = 1e-9 * frequency_hz[:, None]
    inside: NDArray[np.bool_] = (frequency_hz[:, None] >= bands[:, 0] - slack) & (
        frequency_hz[:, None] <= bands[:, 1] + slack
    )
    return inside
