"""Frequency grids: the steps of a sweep, with frequencies of their own for the resonances that fall between them."""

import numpy as np

from base.arrays import Array, Complex, Mask
from engine.device import Device
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.model.plant import Plant

BEAT_HZ = 10.0  # tones closer than this beat within a touch (docs/theory.md#tabulated-quantities): never two such
_PARTS = 4  # parts of a step of the sweep in `fine_frequencies`
_NARROW = 3.0  # a resonance whose half bandwidth is below this many steps of a grid gets frequencies of its own
_CLUSTER = np.sinh(np.linspace(-2.8, 2.8, 17))
"""Distances from a narrow resonance in half bandwidths, up to 8.

With nine up to 4.5 a contrast could be off by 6.7 dB: a finger that holds a sharp resonance back amplifies what a line
between two of them misses. With these the worst of 50 placements on `reference-t` is off by 0.013 dB.
"""


def on_the_wire(frequency_hz: Array) -> Array:
    """The nearest frequencies that the wire carries."""
    return np.round(frequency_hz, 2)


def add_resonances(device: Device, grid_hz: Array, pole: Complex) -> Array:
    """An even grid with 17 frequencies about each narrow resonance and with the edges of all bands.

    pole (pole,): of the plants that are looked at, rad/s. Shape (frequency,), rising, on the steps of the wire.
    """
    half_hz, centre_hz = -pole.real / (2 * np.pi), pole.imag / (2 * np.pi)
    narrow = (pole.imag > 0) & (half_hz < _NARROW * (grid_hz[1] - grid_hz[0]))
    about = (centre_hz[narrow, None] + half_hz[narrow, None] * _CLUSTER).ravel()
    edges = np.array([edge for actuator in device.actuators for edge in actuator.band_hz])
    extra = np.concatenate([about, edges])
    inside = extra[(extra > grid_hz[0]) & (extra < grid_hz[-1])]
    return np.unique(on_the_wire(np.concatenate([grid_hz, inside])))


def fine_frequencies(plant: Plant) -> Array:
    """The sweep of the device in quarter steps, with the resonances of the untouched bar: shape (frequency,)."""
    sweep = plant.device.sweep
    count = _PARTS * round((sweep.stop_hz - sweep.start_hz) / sweep.step_hz) + 1
    grid_hz = np.linspace(sweep.start_hz, sweep.stop_hz, count)
    return add_resonances(plant.device, grid_hz, compute_modal_model(compute_basis(plant)).pole)


def in_band(device: Device, frequency_hz: Array) -> Mask:
    """Shape (frequency, actuator): whether each actuator may play each frequency."""
    low_hz, high_hz = np.array([actuator.band_hz for actuator in device.actuators]).reshape(-1, 2).T
    slack_hz = 1e-9 * frequency_hz[:, None]
    return (frequency_hz[:, None] >= low_hz - slack_hz) & (frequency_hz[:, None] <= high_hz + slack_hz)
