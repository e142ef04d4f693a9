"""Envelopes of the acceleration under fingers while a drive starts from rest."""

import numpy as np

from base.arrays import Array, Complex
from precompute.model.transfers import moved_bases
from precompute.predict.rise_time import RiseModel


def compute_envelopes(model: RiseModel, frequency_hz: Array, amplitude: Complex, time_s: Array) -> tuple[Array, Array]:
    """Frequencies (tone,) and envelopes (tone, case, place, time), m/s^2, of tones started at once at t = 0.

    frequency_hz, amplitude (actuator,). The envelope of a tone is the magnitude of the acceleration under
    exp(j omega t), as in precompute.predict.rise_time, which says when it has risen.
    """
    tones_hz = np.unique(frequency_hz[amplitude != 0])
    out = np.empty((len(tones_hz), *model.shape.shape[:2], len(time_s)))
    moved = moved_bases(model.actuators, frequency_hz, amplitude)
    decay = np.exp(model.pole[:, :, None] * time_s)  # (case, state, time)
    for t, omega in enumerate(2 * np.pi * tones_hz):
        weight = np.where(frequency_hz == tones_hz[t], moved, 0)
        force = (model.spring + 1j * omega * model.damper) @ weight
        state = model.shape * (force / (1j * omega - model.pole))[:, None]
        steady = -(omega**2) * state.sum(axis=2)[:, :, None] * np.exp(1j * omega * time_s)
        out[t] = abs(steady - (state * (model.pole**2)[:, None]) @ decay)
    return tones_hz, out
