"""Laws of the unit responses: the kernel solves any band, power in is power out.

That they are those of the dense model is a law of tests/precompute/sweep/test_grid.py and sampling/test_places.py.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import BANDWIDTH, assemble, dense
from precompute.model.band_solver import solve_banded
from precompute.model.response import solve_response
from tests.precompute.devices import every_device, on_each

Complex = NDArray[np.complex128]
FREQUENCY_HZ = np.array([12.5, 60.0, 121.8, 140.0, 179.35, 208.57, 300.0, 950.0])
any_device = on_each(every_device())


@given(st.integers(1, 40), st.integers(0, 2**32))
def test_banded_kernel_solves_any_band_even_where_pivots_are_small(size: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    K, C, M = random.normal(size=(3, BANDWIDTH + 1, size))
    K[-1] *= random.choice([0.0, 1e-12, 1.0], size)  # diagonal that only pivoting survives
    C[-1] *= 1e-3
    M[-1] = 0.0
    dof, spring, damper = np.array([size // 2]), np.array([1.5]), np.array([0.25])
    out = np.zeros((2, 1, size), dtype=complex)
    omega = np.array([0.3, 2.0])
    weight = np.zeros((1, 4))
    weight[0, : min(4, size - size // 2)] = random.normal(size=min(4, size - size // 2))
    solve_banded(K, C, M, omega, dof, weight, spring, damper, out)
    for w, found in zip(omega, out[:, 0], strict=True):
        matrix = dense(K) + 1j * w * dense(C) - w * w * dense(M)
        right = np.zeros(size, dtype=complex)
        right[size // 2 : size // 2 + 4] = (1.5 + 0.25j * w) * weight[0, : size - size // 2]
        scale = np.abs(matrix).sum(axis=1).max() * np.abs(found).max() + np.abs(right).max()
        assert np.abs(matrix @ found - right).max() <= 1e-12 * scale


@any_device
def test_power_in_is_power_dissipated(device: Device) -> None:
    """Mean power of the bases = that of the actuators' dampers, the bar's material and the fingers, for any drive."""
    fingers = np.array([0.21, 0.6]) * device.bar.length_m
    plant = assemble(device).with_fingers(fingers.tolist(), device.finger)
    random = np.random.default_rng(5)
    shape = (len(FREQUENCY_HZ), len(device.actuators))
    drive = random.normal(size=shape) + 1j * random.normal(size=shape)
    base = drive * [actuator.full_scale_m for actuator in device.actuators]
    omega = 2 * np.pi * FREQUENCY_HZ
    field = np.einsum("fad,fa->fd", solve_response(plant, FREQUENCY_HZ).displacement_m, drive)
    stretch = base - field[:, plant.actuator_dof]
    k, c = np.array([(a.stiffness_n_per_m, a.damping_n_s_per_m) for a in device.actuators]).T
    force = (k + 1j * omega[:, None] * c) * stretch
    power_in = (force * (1j * omega[:, None] * base).conj()).real.sum(axis=1) / 2
    C_bar = dense(plant.C)
    C_bar[plant.actuator_dof, plant.actuator_dof] -= c
    in_bar = np.einsum("fi,ij,fj->f", field.conj(), C_bar, field).real
    dissipated = omega**2 / 2 * (in_bar + (c * np.abs(stretch) ** 2).sum(axis=1))
    assert (power_in > 0).all()
    assert power_in == pytest.approx(dissipated, rel=1e-7)
