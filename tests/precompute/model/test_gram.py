"""Laws of the zone Gram matrices: quadrature, semi-definiteness, shares, the coherent optimum, the mediant bound."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigh

from engine.device import Device, Zone
from precompute.model.assembly import assemble
from precompute.model.gram import compute_gram
from precompute.model.response import Response, solve_response
from tests.precompute.devices import every_device, on_each, shipped

Complex = NDArray[np.complex128]
FREQUENCY_HZ = np.array([20.0, 60.0, 112.0, 140.0, 179.35, 208.57, 230.0, 300.0])
DEVICES = every_device()
any_device = on_each(DEVICES)


def solved(device: Device) -> Response:
    return solve_response(assemble(device), FREQUENCY_HZ)


def middles(start_m: float, stop_m: float, count: int) -> tuple[NDArray[np.float64], float]:
    """Places and step of the midpoint rule."""
    step_m = (stop_m - start_m) / count
    return np.linspace(start_m + step_m / 2, stop_m - step_m / 2, count), step_m


def velocity(response: Response, position_m: NDArray[np.float64]) -> Complex:
    """Shape (frequency, actuator, place): acceleration over j omega."""
    omega = 2j * np.pi * response.frequency_hz[:, None, None]
    field: Complex = response.acceleration(position_m) / omega
    return field


@any_device
def test_zone_gram_equals_brute_force_quadrature_of_velocity(device: Device) -> None:
    response = solved(device)
    gram, _ = compute_gram(response)
    for index, zone in enumerate(device.zones):
        places_m, step_m = middles(zone.start_m, zone.stop_m, 4000)
        field = velocity(response, places_m)
        expected = np.einsum("fap,fbp->fab", field.conj(), field) * step_m
        assert np.abs(gram[:, index] - expected).max() <= 1e-5 * np.abs(expected).max()


@given(st.lists(st.floats(0.001, 0.999), min_size=1, max_size=7, unique_by=lambda x: round(x, 4)))
def test_cutting_zones_anywhere_neither_makes_nor_loses_energy(cuts: list[float]) -> None:
    device = shipped("reference-a")
    edges = [0.0, *(cut * device.bar.length_m for cut in sorted(cuts)), device.bar.length_m]
    zones = tuple(Zone(str(i), *pair) for i, pair in enumerate(itertools.pairwise(edges)))
    gram, total = compute_gram(solved(replace(device, zones=zones)))
    assert np.abs(gram.sum(axis=1) - total).max() <= 1e-12 * np.abs(total).max()


@any_device
def test_two_tones_never_beat_the_better_single_actuator(device: Device) -> None:
    """The mediant bound for every pair of frequencies, ratio and zone (docs/theory.md#objective-and-bound)."""
    gram, all_zones = compute_gram(solved(device))
    first, second = (np.einsum("fzaa->afz", gram).real[i][:, :, None] for i in (0, 1))
    total = np.einsum("faa->af", all_zones).real
    ratio = np.linspace(0.0, 1.0, 21)
    u, v = ratio**2, (1 - ratio) ** 2
    for f1, T1 in enumerate(total[0]):
        for f2, T2 in enumerate(total[1]):
            pair = (u * first[f1] + v * second[f2]) / (u * T1 + v * T2)
            better = np.maximum(first[f1] / T1, second[f2] / T2)
            assert (pair <= better * (1 + 1e-12)).all()


def test_two_by_two_closed_form_is_the_largest_eigenvalue() -> None:
    """Largest lambda = (tr + sqrt(tr^2 - 4 det R / det T)) / 2, tr of T^-1 R (docs/theory.md#objective-and-bound)."""
    gram, total = compute_gram(solved(shipped("reference-a")))
    for R, T in zip(gram[:, 1], total, strict=True):
        trace = np.trace(np.linalg.solve(T, R)).real
        root = np.sqrt(trace**2 - 4 * (np.linalg.det(R) / np.linalg.det(T)).real)
        assert (trace + root) / 2 == pytest.approx(eigh(R, T, eigvals_only=True)[-1], rel=1e-6)
