"""Modes of a surface, untouched or with fingers: natural frequencies, damping ratios, decay times and shapes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Points, even_points
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis, compute_modal_model

POINTS, _ACROSS = 201, 61  # of shapes along a surface, 2 mm apart on 400 mm for nodes; and across a plate
_STILL = 1e-6  # share of the natural frequency below which a pole does not oscillate: it is overdamped, or turns freely


@dataclass(frozen=True, eq=False)
class Mode:
    """One damped mode: amplitudes fall to 1/e in decay_s. shape (point,): greatest displacement 1, at its peak in time.

    Of the pole p: frequency_hz = |p| / 2 pi, damping_ratio = -Re p / |p|, decay_s = -1 / Re p.
    """

    frequency_hz: float
    damping_ratio: float
    decay_s: float
    shape: Array


def seen_points(device: Device) -> Points:
    """Evenly spaced points (point,) that shapes are seen at: along a bar, on a plate rows of POINTS."""
    corner_m = device.surface.corner_m
    return np.asarray(even_points(0 * corner_m, corner_m, POINTS, _ACROSS))


def compute_modes(
    device: Device, position_m: Points, up_to_hz: float, finger_m: Sequence[complex] = ()
) -> tuple[Mode, ...]:
    """Modes up to a frequency, rising, with a finger at each of `finger_m`; shapes are those at position_m (point,)."""
    basis = compute_basis(assemble(device))
    model = compute_modal_model(basis, [(at_m, device.finger) for at_m in finger_m])
    along, count = basis.at(position_m), len(basis.square_omega)
    found = []
    for pole, vector in zip(model.pole, model.vector[:count].T, strict=True):
        size = abs(pole)
        if pole.imag <= _STILL * size or size > 2 * np.pi * up_to_hz or size == 0.0:
            continue
        field = along @ vector
        peak = field[np.argmax(np.abs(field))]
        decay_s = -1 / pole.real if pole.real else np.inf
        found.append(Mode(size / (2 * np.pi), -pole.real / size, float(decay_s), (field / peak).real))
    return tuple(sorted(found, key=lambda mode: mode.frequency_hz))
