"""Rise times t90: how long a drive takes from rest until the fingers feel its steady state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from engine.device import Finger
from precompute.model.modal import Basis, compute_modal_model

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP_S, COARSE_STEP_S = 5e-4, 1e-3
"""The envelope is looked at this often: an excursion just above WITHIN between two looks is missed."""
LONGEST_S = 10.0
"""No rise is followed for longer."""
WITHIN = 0.1
"""Risen: the envelope stays within this fraction of its final value (t90)."""
_NEGLIGIBLE = 1e-4
_SLOW = 0.1  # nepers of decay in a step
_GONE = 30.0
_RENEWED = 64


@dataclass(frozen=True)
class RiseModel:
    """Damped modes of the bar in several cases.

    pole (case, state); shape (case, place, state): what a place sees of each state; spring, damper (case, state,
    actuator): what a base displacement and its rate put in.
    """

    pole: Complex
    shape: Complex
    spring: Complex
    damper: Complex


def compute_rise_model(basis: Basis, cases: Sequence[Sequence[tuple[float, Finger]]], place_m: Array) -> RiseModel:
    """One eigenproblem a case, a case being its fingers (position in metres, finger); place_m (case, place)."""
    models = [compute_modal_model(basis, fingers) for fingers in cases]
    modes = len(basis.square_omega)
    return RiseModel(
        pole=np.stack([model.pole for model in models]),
        shape=np.stack([basis.at(at) @ model.vector[:modes] for model, at in zip(models, place_m, strict=True)]),
        spring=np.stack([model.spring for model in models]),
        damper=np.stack([model.damper for model in models]),
    )


def compute_rise_time(model: RiseModel, frequency_hz: Array, amplitude: Complex, step_s: float = STEP_S) -> Array:
    """Shape (case, place), seconds: from rest, when each place's envelope stays within WITHIN of its final value.

    frequency_hz, amplitude (actuator,): tones started at once at t = 0 (a slew limit adds its own time). The envelope
    of a tone is the magnitude of the acceleration under exp(j omega t); envelopes of different frequencies add, as
    their magnitudes do in paper eq. (8).
    """
    tones = np.unique(frequency_hz[amplitude != 0])
    weight = np.where(frequency_hz == tones[:, None], amplitude, 0)
    out = np.empty(model.shape.shape[:2])
    _fill_rise(2 * np.pi * tones, weight, model.pole, model.shape, model.spring, model.damper, step_s, out)
    return out


_REAL = types.Array(types.float64, 1, "C", readonly=True)
_TWO = types.Array(types.complex128, 2, "C", readonly=True)
_THREE = types.Array(types.complex128, 3, "C", readonly=True)
_OUT = types.Array(types.float64, 2, "C")


@njit(cache=True)
def _left(size, pole, time_s):  # type: ignore[no-untyped-def]  # numba
    """The sum of the magnitudes of all transients at a time, which bounds the distance from the final envelope."""
    total = 0.0
    for t in range(size.shape[0]):
        for s in range(size.shape[1]):
            total += abs(size[t, s]) * np.exp(pole[s].real * time_s)
    return total


@njit(cache=True)
def _scan_back(omega, steady, decaying, pole, final, steps, step_s):  # type: ignore[no-untyped-def]  # numba
    """Scan back in time: the number of steps after which the envelope stays within its band.

    States that decay slowly are followed back by multiplication and renewed every _RENEWED steps against rounding. Fast
    ones matter only near the start and would overflow on the way back, so they are computed directly.
    """
    tones = decaying.shape[0]
    heard = np.sum(np.abs(decaying), axis=0) > 0
    slow = np.flatnonzero(heard & (pole.real * step_s > -_SLOW))
    fast = np.flatnonzero(heard & (pole.real * step_s <= -_SLOW))
    back, turn_back = np.exp(-pole[slow] * step_s), np.exp(-1j * omega * step_s)
    now, turn = np.empty(len(slow), dtype=np.complex128), np.empty(tones, dtype=np.complex128)
    count = 0
    while steps > 0:
        time_s = (steps - 1) * step_s
        if count % _RENEWED == 0:
            now[:] = np.exp(pole[slow] * time_s)
            turn[:] = np.exp(1j * omega * time_s)
        envelope = 0.0
        for t in range(tones):
            value = steady[t] * turn[t]
            for i in range(len(slow)):
                value -= decaying[t, slow[i]] * now[i]
            for s in fast:
                if pole[s].real * time_s > -_GONE:
                    value -= decaying[t, s] * np.exp(pole[s] * time_s)
            envelope += abs(value)
        if abs(envelope - final) > WITHIN * final:
            break
        now *= back
        turn *= turn_back
        steps -= 1
        count += 1
    return steps


@njit(types.void(_REAL, _TWO, _TWO, _THREE, _THREE, _THREE, types.float64, _OUT), cache=True)
def _fill_rise(omega, weight, pole, shape, spring, damper, step_s, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (case, place): scan back from the time after which the transients cannot matter any more."""
    tones, actuators = weight.shape
    states = pole.shape[1]
    for k in range(pole.shape[0]):
        steady = np.empty(tones, dtype=np.complex128)
        decaying = np.empty((tones, states), dtype=np.complex128)
        for p in range(shape.shape[1]):
            # Steady state and transients of each tone, and the final envelope.
            final = 0.0
            for t in range(tones):
                steady[t] = 0j
                for s in range(states):
                    force = 0j
                    for a in range(actuators):
                        force += (spring[k, s, a] + 1j * omega[t] * damper[k, s, a]) * weight[t, a]
                    state = shape[k, p, s] * force / (1j * omega[t] - pole[k, s])
                    steady[t] -= omega[t] ** 2 * state
                    decaying[t, s] = state * pole[k, s] ** 2
                final += abs(steady[t])
            for t in range(tones):
                for s in range(states):
                    if abs(decaying[t, s]) < _NEGLIGIBLE * final:
                        decaying[t, s] = 0
            # Bisection for the time at which the bound on the transients falls below WITHIN.
            low, high = 0.0, LONGEST_S
            while high - low > step_s:
                middle = 0.5 * (low + high)
                if _left(decaying, pole[k], middle) > WITHIN * final:
                    low = middle
                else:
                    high = middle
            steps = int(np.ceil(high / step_s))
            out[k, p] = _scan_back(omega, steady, decaying, pole[k], final, steps, step_s) * step_s
