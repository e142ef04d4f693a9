"""The mesh that follows from the band is converged, on bars of other materials and sizes too."""

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.device.surface_description import CLICKS_TOP_HZ
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.model.plant import Plant
from precompute.model.response import solve_response
from tests.precompute.devices import any_bar, with_bar

MODES = 60


def refined(device: Device, times: int) -> Plant:
    return assemble(with_bar(device, largest_element_m=device.bar.largest_element_m / times))


def frequencies(device: Device, start_hz: float, stop_hz: float) -> Array:
    """An even grid with seven frequencies about each resonance: the flanks, where a shift shows most, and the top."""
    pole = compute_modal_model(compute_basis(refined(device, 4), MODES)).pole
    pole = pole[(pole.imag > 0) & (pole.imag < 2 * np.pi * stop_hz)]
    about = (pole.imag[:, None] - pole.real[:, None] * np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])) / (2 * np.pi)
    hz = np.unique(np.concatenate([np.linspace(start_hz, stop_hz, 241), about.ravel()]))
    inside: Array = hz[(hz >= start_hz) & (hz <= stop_hz)]
    return inside


def error(device: Device, frequency_hz: Array) -> Array:
    """Greatest distance (frequency, actuator) along the bar from a mesh four times finer."""
    places_m = np.linspace(0.0, device.bar.length_m, 41)
    own, fine = (solve_response(refined(device, n), frequency_hz).acceleration(places_m) for n in (1, 4))
    distance: Array = abs(own - fine).max(axis=2) / abs(fine).max(axis=2)
    return distance


@any_bar
def test_responses_are_right_to_a_twentieth_of_a_percent_at_resonances_and_in_the_band_of_clicks_too(
    device: Device,
) -> None:
    for stop_hz in (device.sweep.stop_hz, CLICKS_TOP_HZ):
        assert error(device, frequencies(device, device.sweep.start_hz, stop_hz)).max() < 5e-4
