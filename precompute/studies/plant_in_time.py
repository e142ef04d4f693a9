"""Accelerations under fingers in time: a surface's modes step by step, for many placements of fingers at once.

Fingers' springs and masses join the modes of the surface with its actuators, which then damp as sigma + eta omega^2.
What is left to couple them are dampers, each at one point. A step of a mode is exact where the force on it runs
straight from sample to sample. A damper's force is -d times the velocity at its point at the end of the same step,
which it changes itself: a small linear system, solved once for all steps. That this force is not quite straight within
a step costs 0.5 % of the damping at 300 Hz and 8 kHz.
"""

import numpy as np

from base.arrays import Array
from base.compiled import njit
from precompute.model.modal import Basis, mount_dampers

_STILL = 1.0  # (rad/s)^2: given to modes without stiffness, such as the turning about a single actuator


def accelerations(basis: Basis, shape: Array, grounded: Array, nodes: Array, force_n: Array, rate_hz: float) -> Array:
    """Accelerations (placement, case, finger, time) in m/s^2 under fingers, from rest.

    basis: of the untouched surface. shape (placement, finger, mode): its mode shapes at the fingers. grounded
    (placement, finger, 3): stiffness, damping and mass between the surface and the ground, N/m, N s/m, kg. nodes
    (placement, finger, node, 5): stiffness and damping between the surface and a node, stiffness and damping between
    the node and the ground, and the node's mass. force_n (placement, case, actuator, time): forces of the actuators on
    the surface, straight between samples.
    """
    bar = basis.plant.device.surface
    square, row, damper = _join(basis, shape, grounded, nodes, bar.mass_damping_per_s, bar.stiffness_damping_s)
    own = bar.mass_damping_per_s + bar.stiffness_damping_s * square
    step = _steps_of(square, own, 1 / rate_hz)
    # Velocity at a point by the force at another, at the end of the step in which it rises from 0.
    mobility = (row * step[:, 7:8]) @ row.swapaxes(1, 2)
    back = np.linalg.inv(np.eye(row.shape[1]) + mobility * damper[:, None]).swapaxes(1, 2) @ (-damper[..., None] * row)
    out = np.empty((*force_n.shape[:2], shape.shape[1], force_n.shape[-1]))
    fill_accelerations(row, np.ascontiguousarray(back), step, force_n, out)
    return out


def _join(
    basis: Basis, shape: Array, grounded: Array, nodes: Array, sigma_per_s: float, eta_s: float
) -> tuple[Array, Array, Array]:
    """Modes of surface and fingers: omega^2 (placement, mode) and shapes (placement, point, mode); their dampers.

    Points are the actuators, the fingers, the nodes seen from the surface, and the nodes. The dampers (placement,
    point), N s/m, are without what is in sigma + eta omega^2 already.
    """
    (placements, fingers, modes), each, mounts = shape.shape, nodes.shape[2], mount_dampers(basis)
    own, untouched = fingers * each, range(modes)
    at_actuators = np.broadcast_to(basis.at_actuators, (placements, *basis.at_actuators.shape))
    at_surface = np.pad(np.concatenate([at_actuators, shape], axis=1), ((0, 0), (0, 0), (0, own)))
    at_nodes = np.broadcast_to(np.eye(own, modes + own, modes), (placements, own, modes + own))
    between = np.repeat(at_surface[:, len(mounts) :], each, axis=1) - at_nodes
    row = np.concatenate([at_surface, between, at_nodes], axis=1)
    node = nodes.reshape(placements, own, 5)
    still = np.pad(node[..., :2], ((0, 0), (0, 0), (0, 1)))
    at_mounts = np.broadcast_to([(0.0, damper, 0.0) for damper in mounts], (placements, len(mounts), 3))
    attached = np.concatenate([at_mounts, grounded, still, node[..., 2:]], axis=1)
    K, M = ((row * attached[..., part, None]).swapaxes(1, 2) @ row for part in (0, 2))
    K[:, untouched, untouched] += basis.square_omega
    M[:, untouched, untouched] += 1.0
    whitening = np.linalg.inv(np.linalg.cholesky(M))
    square, vector = np.linalg.eigh(whitening @ K @ whitening.swapaxes(1, 2))
    damper = attached @ (-eta_s, 1.0, -sigma_per_s)
    return np.maximum(square, _STILL), row @ (whitening.swapaxes(1, 2) @ vector), damper


def _steps_of(square: Array, own: Array, step_s: float) -> Array:
    """Shape (placement, 10, mode): what makes deflection q and velocity v after a step; own and square.

    By q and v before: q from q, q from v, v from q, v from v; by the force before: q, v; by the force after: q, v.
    """
    root = np.sqrt((own**2 / 4 - square).astype(np.complex128))
    one, other = -own / 2 + root, -own / 2 - root
    first, second = np.exp(one * step_s), np.exp(other * step_s)
    q_q, q_v = ((one * second - other * first) / (2 * root)).real, ((first - second) / (2 * root)).real
    v_q, v_v = -square * q_v, ((one * first - other * second) / (2 * root)).real
    # Integrals over a step of the response to a constant force, and to one that rises to 1 in it.
    q_held = (1 - q_q) / square
    q_rising, v_rising = (1 - (own * q_held + q_v) / step_s) / square, q_held / step_s
    return np.stack([q_q, q_v, v_q, v_v, q_held - q_rising, q_v - v_rising, q_rising, v_rising, own, square], axis=1)


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def fill_accelerations(row: Array, back: Array, step: Array, force_n: Array, out: Array) -> None:
    """Fill out (placement, case, finger, time) by force_n (placement, case, actuator, time).

    row (placement, point, mode): shapes. back: modal forces of the dampers by the velocities at the points. step
    (placement, 10, mode) of `_steps_of`.
    """
    (placements, points, modes), (cases, actuators, steps) = row.shape, force_n.shape[1:]
    q, v, f, added = np.empty(modes), np.empty(modes), np.empty(modes), np.zeros(modes)
    for p in range(placements):
        for case in range(cases):
            q[:], v[:], f[:] = 0.0, 0.0, 0.0
            for t in range(steps):
                for a in range(actuators):
                    for m in range(modes):
                        added[m] += row[p, a, m] * force_n[p, case, a, t]
                for m in range(modes):
                    before, rate, last = q[m], v[m], f[m]
                    q[m] = (
                        step[p, 0, m] * before + step[p, 1, m] * rate + step[p, 4, m] * last + step[p, 6, m] * added[m]
                    )
                    v[m] = (
                        step[p, 2, m] * before + step[p, 3, m] * rate + step[p, 5, m] * last + step[p, 7, m] * added[m]
                    )
                    f[m], added[m] = added[m], 0.0
                for i in range(points):
                    rate = 0.0
                    for m in range(modes):
                        rate += row[p, i, m] * v[m]
                    for m in range(modes):
                        added[m] += back[p, i, m] * rate
                for m in range(modes):
                    q[m] += step[p, 6, m] * added[m]
                    v[m] += step[p, 7, m] * added[m]
                    f[m] += added[m]
                for i in range(out.shape[2]):
                    total = 0.0
                    for m in range(modes):
                        total += row[p, actuators + i, m] * (f[m] - step[p, 8, m] * v[m] - step[p, 9, m] * q[m])
                    out[p, case, i, t] = total
                added[:] = 0.0
