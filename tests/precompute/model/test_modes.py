"""Modes of a bar: those of the textbook, of the responses' peaks, and what a finger does to them."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modes import Mode, compute_modes
from precompute.model.response import solve_response
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
POINTS_M = np.linspace(0.0, DEVICE.bar.length_m, 101)


def modes_of(device: Device, *finger_m: float, up_to_hz: float = 1000.0) -> tuple[Mode, ...]:
    return compute_modes(device, POINTS_M, up_to_hz, finger_m)


def test_a_bar_on_soft_springs_has_the_modes_of_a_free_beam() -> None:
    """Free-free Euler-Bernoulli beam: beta L = 4.730041, 7.853205, 10.995608 (Blevins, table 8-1)."""
    soft = [replace(a, stiffness_n_per_m=1e-3, mass_kg=0.0, damping_n_s_per_m=0.0) for a in DEVICE.actuators]
    bar = DEVICE.bar
    free = modes_of(replace(DEVICE, actuators=tuple(soft)), up_to_hz=400.0)
    mass = bar.density_kg_per_m3 * bar.width_m * bar.thickness_m
    bending = bar.youngs_modulus_pa * bar.width_m * bar.thickness_m**3 / 12
    expected = [
        (root / bar.length_m) ** 2 * np.sqrt(bending / mass) / (2 * np.pi) for root in (4.730041, 7.853205, 10.995608)
    ]
    elastic = [mode.frequency_hz for mode in free if mode.frequency_hz > 1.0]
    assert elastic[:3] == pytest.approx(expected, rel=1e-4)


def test_frequency_and_damping_are_those_of_the_peak_of_the_response() -> None:
    """At f (1 +- zeta) the magnitude of a mode far from others is 1 / sqrt 2 of that at its peak."""
    mode = modes_of(DEVICE)[0]  # 34 Hz; the next is at 122 Hz
    about_hz = mode.frequency_hz * (1 + mode.damping_ratio * np.array([-1.0, 0.0, 1.0]))
    low, peak, high = np.abs(solve_response(assemble(DEVICE), about_hz).displacement_m[:, 0, 0])
    assert [low / peak, high / peak] == pytest.approx([2**-0.5] * 2, rel=0.08)


def test_the_modes_rise_and_end_where_they_are_asked_to() -> None:
    found = [mode.frequency_hz for mode in modes_of(DEVICE, up_to_hz=300.0)]
    assert found == sorted(found) and found[-1] <= 300.0
    assert len(modes_of(DEVICE, up_to_hz=600.0)) > len(found)
