"""Unit responses of the plant: one complex solve a frequency, a column for each actuator or touched point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex, Points
from engine.device import Actuator
from precompute.model.plant import Plant, Sampler
from precompute.model.transfers import transfers_at


@dataclass(frozen=True)
class Response:
    """Displacement of the surface, shape (frequency, column, degree of freedom).

    Metres per full-scale base displacement for an actuator's column, metres per newton for a touched point's.
    """

    plant: Plant
    frequency_hz: Array
    displacement_m: Complex

    def acceleration(self, position_m: Points) -> Complex:
        """A = -omega^2 G at positions (point,): shape (frequency, column, point), m/s^2 at full scale."""
        omega = 2 * np.pi * self.frequency_hz
        return -(omega**2)[:, None, None] * self.plant.sampler(position_m).sample(self.displacement_m)


def by_tone(frequency_hz: Array, amplitude: Complex) -> tuple[Array, Complex]:
    """Frequencies (tone,) of what moves in a drive (actuator,), and its amplitudes at each (tone, actuator)."""
    tones_hz = np.unique(frequency_hz[amplitude != 0])
    return tones_hz, np.where(frequency_hz == tones_hz[:, None], amplitude, 0)


def peak_along(plant: Plant, frequency_hz: Array, amplitude: Complex, position_m: Points) -> Array:
    """Peak steady acceleration (point,), m/s^2, of a drive (actuator,) at positions (point,).

    Fields of one frequency add, those of several as magnitudes (paper eq. (8)).
    """
    tones_hz, weight = by_tone(frequency_hz, amplitude)
    field = np.einsum("ta,tap->tp", weight, solve_response(plant, tones_hz).acceleration(position_m))
    return abs(field).sum(axis=0)


def blocked_force(actuators: Sequence[Actuator], frequency_hz: Array) -> Complex:
    """F_i = (k_i + j omega c_i) alpha_i H_i: force (frequency, actuator), N, of full scale on a bar that is held."""
    jw = 2j * np.pi * frequency_hz
    force = [a.spring_force_n + jw * a.damper_force_n_s for a in actuators]
    transfers = transfers_at(actuators, jw)
    return np.stack(force, axis=-1) * (1.0 if transfers is None else transfers)


def solve_response(plant: Plant, frequency_hz: Array, touched_m: Points | None = None) -> Response:
    """G(omega) = (K + j omega C - omega^2 M)^-1 F(omega), F_i = (k_i + j omega c_i) alpha_i H_i (docs/theory.md#model).

    H_i is the transfer function of an actuator, 1 where the device file has none. A column for each actuator, as
    measured where it was (H_i is in that already), then one for a unit force at each position of `touched_m`.
    """
    actuators, own = plant.device.actuators, plant.actuators
    touched = plant.sampler(np.zeros(0) if touched_m is None else touched_m)
    points, width = len(touched.dof), max(own.dof.shape[1], touched.dof.shape[1])
    # Beyond an actuator's own degrees of freedom there are more of weight 0, so that all loads are of one width.
    spare, none = np.repeat(own.dof[:, -1:], width - own.dof.shape[1], axis=1), (len(own.dof), width - own.dof.shape[1])
    dof = np.concatenate([np.hstack([own.dof, spare]), touched.dof])
    weight = np.concatenate([np.hstack([own.weight, np.zeros(none)]), touched.weight])
    out = plant.solve(
        2 * np.pi * np.asarray(frequency_hz, dtype=np.float64),
        Sampler(dof, weight),
        np.array([a.spring_force_n for a in actuators] + [1.0] * points),
        np.array([a.damper_force_n_s for a in actuators] + [0.0] * points),
    )
    transfers = transfers_at(actuators, 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64))
    if transfers is not None:
        out[:, : len(actuators)] *= transfers[..., None]
    known = plant.known_drive(np.asarray(frequency_hz, dtype=np.float64))
    if known is not None:
        out[:, : len(actuators)] = np.einsum("df,fak->kad", *known, optimize=True)
    return Response(plant, np.asarray(frequency_hz, dtype=np.float64), out)
