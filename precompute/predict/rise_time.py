"""Rise times t90: how long a drive takes from rest until the fingers feel its steady state.

The envelope is scanned back in time from where the transients cannot matter any more, and the first look at which it is
outside its band ends the scan. A transient of pole p beats with a tone at |p - j omega|, so looks are _LOOKS to the
period of the fastest beat that is still heard there, which changes as transients decay. An excursion between two looks
is found by the parabola through three of them, and the crossing is interpolated: t90 has no step of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import types

from base.arrays import Array, Complex
from base.compiled import njit
from engine.device import Actuator, Finger
from precompute.model.modal import Basis, compute_modal_model
from precompute.model.transfers import moved_bases

WITHIN = 0.1  # risen: the envelope stays within this fraction of its final value (t90)
_HEARD = 2e-4  # transients below this fraction of the final envelope are left out: 0.2 % of the band
_LOOKS = 16  # looks in a period of the fastest beat; of two tones the envelope has cusps, which eight looks may miss
_BLOCK = 64  # looks after which the transients that are heard are chosen again, and computed afresh against rounding
LONGEST_RISE_S = 10.0  # no rise is followed for longer: this t90 stands for every longer one
_FOLLOWED_S = 4 * LONGEST_RISE_S  # the scan starts at most this late, so that its start cuts off no shorter rise


@dataclass(frozen=True)
class RiseModel:
    """Damped modes of the bar under its fingers.

    pole (state,); shape (place, state): what a place sees of each state; spring, damper (state, actuator): what a base
    displacement and its rate put in. How an actuator's own transfer function rises is left out: a tone moves its base
    as in the steady state from the start.
    """

    actuators: tuple[Actuator, ...]
    pole: Complex
    shape: Complex
    spring: Complex
    damper: Complex


def compute_rise_model(basis: Basis, fingers: Sequence[tuple[complex, Finger]], place_m: Array) -> RiseModel:
    """The model under fingers (position in metres, finger), seen at place_m (place,): one eigenproblem."""
    model = compute_modal_model(basis, fingers)
    shape = basis.at(place_m) @ model.vector[: len(basis.square_omega)]
    return RiseModel(basis.plant.device.actuators, model.pole, shape, model.spring, model.damper)


def compute_rise_time(model: RiseModel, frequency_hz: Array, amplitude: Complex) -> Array:
    """Shape (place,), seconds: from rest, when each place's envelope stays within WITHIN of its final value.

    LONGEST_RISE_S stands for every longer time.

    frequency_hz, amplitude (actuator,): tones started at once at t = 0 (a slew limit adds its own time). The envelope
    of a tone is the magnitude of the acceleration under exp(j omega t); envelopes of different frequencies add, as
    their magnitudes do in paper eq. (8).
    """
    tones = np.unique(frequency_hz[amplitude != 0])
    weight = np.where(frequency_hz == tones[:, None], moved_bases(model.actuators, frequency_hz, amplitude), 0)
    out = np.empty(len(model.shape))
    _fill_rise(2 * np.pi * tones, weight, model.pole, model.shape, model.spring, model.damper, out)
    return out


def compute_envelopes(model: RiseModel, frequency_hz: Array, amplitude: Complex, time_s: Array) -> tuple[Array, Array]:
    """Frequencies (tone,) and envelopes (tone, place, time), m/s^2, of tones started at once at t = 0.

    frequency_hz, amplitude (actuator,). The envelope of a tone is the magnitude of the acceleration under
    exp(j omega t), as in `compute_rise_time`, which says when it has risen.
    """
    tones_hz = np.unique(frequency_hz[amplitude != 0])
    out = np.empty((len(tones_hz), len(model.shape), len(time_s)))
    moved = moved_bases(model.actuators, frequency_hz, amplitude)
    decay = np.exp(model.pole[:, None] * time_s)  # (state, time)
    for t, omega in enumerate(2 * np.pi * tones_hz):
        weight = np.where(frequency_hz == tones_hz[t], moved, 0)
        force = (model.spring + 1j * omega * model.damper) @ weight
        state = model.shape * (force / (1j * omega - model.pole))
        steady = -(omega**2) * state.sum(axis=1)[:, None] * np.exp(1j * omega * time_s)
        out[t] = abs(steady - (state * model.pole**2) @ decay)
    return tones_hz, out


_REAL = types.Array(types.float64, 1, "C", readonly=True)
_ONE = types.Array(types.complex128, 1, "C", readonly=True)
_TWO = types.Array(types.complex128, 2, "C", readonly=True)
_OUT = types.Array(types.float64, 1, "C")


@njit(cache=True)
def _left(size, pole, time_s):  # type: ignore[no-untyped-def]  # numba
    """The sum of the magnitudes of all transients at a time, which bounds the distance from the final envelope."""
    total = 0.0
    for t in range(size.shape[0]):
        for s in range(size.shape[1]):
            total += abs(size[t, s]) * np.exp(pole[s].real * time_s)
    return total


@njit(cache=True)
def _fastest_beat(omega, decaying, pole, final, time_s, heard):  # type: ignore[no-untyped-def]  # numba
    """Mark in heard (state,) the transients that are heard from time_s on; their fastest rate |p - j omega|, rad/s."""
    fastest = 0.0
    for s in range(len(pole)):
        heard[s] = False
        for t in range(len(omega)):
            if abs(decaying[t, s]) * np.exp(pole[s].real * time_s) > _HEARD * final:
                heard[s] = True
                fastest = max(fastest, abs(pole[s] - 1j * omega[t]))
    return fastest


@njit(cache=True)
def _scan_block(omega, steady, decaying, pole, final, kept, last_s, step_s, count):  # type: ignore[no-untyped-def]  # numba
    """Scan `count` looks back from last_s: the time at which the envelope enters its band for good, or -1.

    The states `kept` are followed back by multiplication.
    """
    tones, size, limit = len(omega), len(kept), WITHIN * final
    back, turn_back = np.exp(-pole[kept] * step_s), np.exp(-1j * omega * step_s)
    now, turn = np.exp(pole[kept] * last_s), np.exp(1j * omega * last_s)
    later, middle = 0.0, 0.0  # distances from the final envelope at the two looks before
    for k in range(count):
        envelope = 0.0
        for t in range(tones):
            value = steady[t] * turn[t]
            for i in range(size):
                value -= decaying[t, kept[i]] * now[i]
            envelope += abs(value)
        distance, middle_s = envelope - final, last_s - (k - 1) * step_s
        is_outside = abs(distance) > limit
        if is_outside and k < 2:
            return middle_s - step_s
        # side * distance = c + b x + a x^2 through three looks, x in steps from the middle one.
        side = 1.0 if (distance if is_outside else middle) > 0 else -1.0
        a, b, c = side * (0.5 * (later + distance) - middle), 0.5 * side * (later - distance), side * middle
        if is_outside:  # and the look before was inside: the crossing between them, -1 < x < 0
            root = np.sqrt(max(b * b - 4 * a * (c - limit), 0.0))
            return middle_s + step_s * (2 * (limit - c) / (b - root) if b < 0 else -0.5 * (b + root) / a)
        if k > 1 and a < 0 and abs(b) <= -2 * a and c - b * b / (4 * a) > limit:  # a turn outside, between looks
            return middle_s - step_s * 0.5 * (b + np.sqrt(b * b - 4 * a * (c - limit))) / a
        later, middle = middle, distance
        now *= back
        turn *= turn_back
    return -1.0


@njit(cache=True)
def _block_length(fastest, longest_s):  # type: ignore[no-untyped-def]  # numba
    """Duration of _BLOCK looks at a beat of that rate; `longest_s` at most."""
    return longest_s if fastest == 0 else min(longest_s, _BLOCK * 2 * np.pi / (_LOOKS * fastest))


@njit(cache=True)
def _scan_back(omega, steady, decaying, pole, final, end_s):  # type: ignore[no-untyped-def]  # numba
    """Scan back in time from end_s, block by block: the time from which on the envelope stays within its band."""
    heard = np.empty(len(pole), dtype=np.bool_)
    time_s = end_s
    while time_s > 0:
        # The step follows from what is heard at the block's early end: there more is, and faster beats. The block is
        # no longer than the first guess, from what is heard at its late end.
        guess_s = _block_length(_fastest_beat(omega, decaying, pole, final, time_s, heard), time_s)
        block_s = _block_length(_fastest_beat(omega, decaying, pole, final, time_s - guess_s, heard), guess_s)
        step_s = block_s / _BLOCK
        # One look later and one earlier than the block, so that a turn at its ends is seen too.
        kept = np.flatnonzero(heard)
        found = _scan_block(omega, steady, decaying, pole, final, kept, time_s + step_s, step_s, _BLOCK + 2)
        if found >= 0:
            return found
        time_s -= block_s
    return 0.0


@njit(types.void(_REAL, _TWO, _ONE, _TWO, _TWO, _TWO, _OUT), cache=True)
def _fill_rise(omega, weight, pole, shape, spring, damper, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (place,): scan back from the time after which the transients cannot matter any more."""
    tones, actuators = weight.shape
    steady = np.empty(tones, dtype=np.complex128)
    decaying = np.empty((tones, len(pole)), dtype=np.complex128)
    for p in range(len(shape)):
        # Steady state and transients of each tone, and the final envelope.
        final = 0.0
        for t in range(tones):
            steady[t] = 0j
            for s in range(len(pole)):
                force = 0j
                for a in range(actuators):
                    force += (spring[s, a] + 1j * omega[t] * damper[s, a]) * weight[t, a]
                state = shape[p, s] * force / (1j * omega[t] - pole[s])
                steady[t] -= omega[t] ** 2 * state
                decaying[t, s] = state * pole[s] ** 2
            final += abs(steady[t])
        # Bisection for the time at which the bound on the transients falls below WITHIN.
        low, high = 0.0, _FOLLOWED_S
        if _left(decaying, pole, high) > WITHIN * final:
            out[p] = LONGEST_RISE_S
            continue
        while high - low > 1e-3 * high:
            middle = 0.5 * (low + high)
            if _left(decaying, pole, middle) > WITHIN * final:
                low = middle
            else:
                high = middle
        out[p] = min(_scan_back(omega, steady, decaying, pole, final, high), LONGEST_RISE_S)
