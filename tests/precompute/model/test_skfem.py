"""Cross-check: scikit-fem's Hermite element assembles the same bar; springs, dampers and masses are added by hand."""

from typing import Any

import numpy as np
from skfem import Basis, BilinearForm, ElementLineHermite, MeshLine

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import BarPlant, assemble_bar, dense
from tests.precompute.devices import every_device, on_each

any_device = on_each(every_device())


def _bending(u: Any, v: Any, _: Any) -> Any:
    return u.hess[0, 0] * v.hess[0, 0]


def _inertia(u: Any, v: Any, _: Any) -> Any:
    return u * v


def assemble_independently(plant: BarPlant) -> tuple[Array, ...]:
    """K, C, M of the untouched device on the plant's nodes, full; degrees of freedom (deflection, slope) by node."""
    bar = plant.device.bar
    basis = Basis(MeshLine(plant.node_m), ElementLineHermite(), intorder=6)
    order = basis.nodal_dofs.T.ravel()
    curvature, square = (
        BilinearForm(form).assemble(basis).toarray()[np.ix_(order, order)] for form in (_bending, _inertia)
    )
    K = bar.youngs_modulus_pa * bar.width_m * bar.thickness_m**3 / 12 * curvature
    M = bar.density_kg_per_m3 * bar.width_m * bar.thickness_m * square
    C = bar.mass_damping_per_s * M + bar.stiffness_damping_s * K
    for actuator in plant.device.actuators:
        dof = 2 * int(np.argmin(np.abs(plant.node_m - actuator.position_m)))
        K[dof, dof] += actuator.stiffness_n_per_m
        C[dof, dof] += actuator.damping_n_s_per_m
        M[dof, dof] += actuator.mass_kg
    return K, C, M


@any_device
def test_matrices_equal_scikit_fems(device: Device) -> None:
    plant = assemble_bar(device)
    unit = np.tile([1.0, 1.0 / device.bar.largest_element_m], plant.size // 2)  # slopes and deflections alike
    for band, expected in zip((plant.K, plant.C, plant.M), assemble_independently(plant), strict=True):
        difference = unit[:, None] * (dense(band) - expected) * unit
        assert np.abs(difference).max() <= 1e-8 * np.abs(unit[:, None] * expected * unit).max()
