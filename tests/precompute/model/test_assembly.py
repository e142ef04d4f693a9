"""Laws of the assembled plant: mesh, damping, fingers, natural frequencies at order 4."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import eigh
from scipy.optimize import brentq

from base.arrays import Array
from engine.device import Device, Zone
from precompute.model.assembly import assemble_bar, build_mesh, dense
from tests.precompute.devices import shipped, with_bar

places = st.floats(0.0, 1.0)


@st.composite
def meshed(draw: st.DrawFn) -> Device:
    """A bar with one to five actuators, some zones, and a largest element: all anywhere."""
    device = with_bar(shipped("reference-a"), length_m=draw(st.floats(0.01, 2.0)))
    length_m = device.bar.length_m
    device = with_bar(device, largest_element_m=length_m * draw(st.floats(5e-3, 3.0)))
    at = draw(st.lists(places, min_size=1, max_size=5, unique=True))
    actuators = tuple(replace(device.actuators[0], position_m=min(p * length_m, length_m)) for p in at)
    edges = sorted(draw(st.sets(places, min_size=2, max_size=9)))
    zones = tuple(Zone(str(i), a * length_m, b * length_m) for i, (a, b) in enumerate(itertools.pairwise(edges)))
    return replace(device, actuators=actuators, zones=zones)


@given(meshed())
def test_mesh_has_a_node_at_every_place_no_element_longer_than_asked_and_no_node_too_many(device: Device) -> None:
    node_m, length_m = build_mesh(device), device.bar.length_m
    wanted = [0.0, length_m, *(actuator.position_m for actuator in device.actuators)]
    wanted += [edge for zone in device.zones for edge in (zone.start_m, zone.stop_m)]
    assert node_m[0] == 0.0 and node_m[-1] == length_m
    for place in wanted:  # places closer than a millionth of the bar may share a node
        assert np.abs(node_m - place).min() <= 1.01e-6 * length_m
    assert np.diff(node_m).max() <= device.bar.largest_element_m * (1 + 1e-8)
    assert np.diff(node_m).min() > 0.5e-6 * length_m
    assert len(node_m) <= len(wanted) + length_m / device.bar.largest_element_m + 1


def _natural_omegas(elements: int, clamped: list[int], rigid: int) -> Array:
    """First three elastic modes of REF-A's bar, rad/s, without the degrees of freedom in `clamped`."""
    device = shipped("reference-a")
    even = with_bar(device, largest_element_m=device.bar.length_m / elements)
    free = assemble_bar(replace(even, actuators=(), zones=()))
    keep = np.delete(np.arange(free.size), clamped)
    squares = eigh(dense(free.K)[np.ix_(keep, keep)], dense(free.M)[np.ix_(keep, keep)], eigvals_only=True)
    omegas: Array = np.sqrt(squares[rigid : rigid + 3])
    return omegas


@pytest.mark.parametrize(
    ("characteristic", "first", "clamped", "rigid"),
    [
        (lambda x: np.cos(x) - 1 / np.cosh(x), 1.5, [], 2),
        (np.sin, 1.0, [0, -2], 0),
        (lambda x: np.cos(x) + 1 / np.cosh(x), 0.5, [0, 1], 0),
    ],
    ids=["free-free", "pinned-pinned", "cantilever"],
)
def test_natural_frequencies_converge_at_order_four_to_the_closed_forms(
    characteristic: Callable[[float], float], first: float, clamped: list[int], rigid: int
) -> None:
    bar = shipped("reference-a").bar
    wavenumbers = [brentq(characteristic, (first + n - 0.2) * np.pi, (first + n + 0.2) * np.pi) for n in range(3)]
    speed = np.sqrt(bar.youngs_modulus_pa / bar.density_kg_per_m3 / 12) * bar.thickness_m  # sqrt(EI / rho A)
    exact = (np.array(wavenumbers) / bar.length_m) ** 2 * speed
    coarse, fine = (_natural_omegas(elements, clamped, rigid) / exact - 1 for elements in (14, 28))
    assert (fine > 0).all(), "a conforming element with consistent mass is too stiff, never too soft"
    assert (fine < 2e-5).all()
    order = np.log2(coarse / fine)
    assert ((order > 3.8) & (order < 4.2)).all(), order
