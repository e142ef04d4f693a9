"""The plant to its unit responses: one banded complex solve a frequency, one column an actuator."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.assembly import Plant
from precompute.banded import solve_banded


@dataclass(frozen=True)
class Response:
    """Displacement per full-scale base displacement: (frequency, actuator, degree of freedom), in metres."""

    plant: Plant
    frequency_hz: NDArray[np.float64]
    displacement_m: NDArray[np.complex128]

    def acceleration(self, position_m: NDArray[np.float64]) -> NDArray[np.complex128]:
        """A = -omega^2 G at positions (point,): shape (frequency, actuator, point), m/s^2 at full scale."""
        omega = 2 * np.pi * self.frequency_hz
        return -(omega**2)[:, None, None] * self.plant.sampler(position_m).sample(self.displacement_m)


def solve_response(plant: Plant, frequency_hz: NDArray[np.float64]) -> Response:
    """G(omega) = (K + j omega C - omega^2 M)^-1 F(omega), F_i = (k_i + j omega c_i) alpha_i (PHYSICS.md section 1)."""
    actuators = plant.device.actuators
    out = np.zeros((len(frequency_hz), len(actuators), plant.size), dtype=np.complex128)
    solve_banded(
        plant.K,
        plant.C,
        plant.M,
        2 * np.pi * np.ascontiguousarray(frequency_hz, dtype=np.float64),
        plant.actuator_dof,
        np.array([a.stiffness_n_per_m * a.full_scale_m for a in actuators]),
        np.array([a.damping_n_s_per_m * a.full_scale_m for a in actuators]),
        out,
    )
    return Response(plant, np.asarray(frequency_hz, dtype=np.float64), out)
