"""Sampled bars: bars that a calibration cannot tell apart, each with one case of the sampled fingers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import prange, types
from numpy.typing import NDArray

from base.compiled import njit
from engine.device import Device
from engine.steady.cases import SEED
from precompute.model.assembly import BANDWIDTH, BarPlant, assemble_bar
from precompute.model.band_solver import BAND_ROWS, FIRST_SUPER, eliminate
from precompute.model.transfers import moved_bases
from precompute.sampling.fingers import SampledFingers
from precompute.sampling.plants import sample_scenarios

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class SampledBars:
    """One bar for each sampled case of `sampled`; its first case, the standard one, has none.

    plants: on one mesh. K, C, M (bar, band row, degree of freedom); spring, damper (bar, actuator): force of a base at
    full scale, per unit of its displacement and of its velocity.
    """

    plants: tuple[BarPlant, ...]
    sampled: SampledFingers
    K: Array
    C: Array
    M: Array
    spring: Array
    damper: Array

    def powers(self, touched: Sequence[int], frequency_hz: Array, amplitude: Complex) -> Array:
        """Power over threshold under each finger (bar, finger), fingers in the zones `touched` (indices).

        frequency_hz, amplitude (actuator,): the drive, as fractions of full scale; powers of different tones add.
        """
        tones = np.unique(frequency_hz[amplitude != 0])
        moved = moved_bases(self.plants[0].device.actuators, frequency_hz, amplitude)
        weight = np.where(frequency_hz == tones[:, None], moved, 0)
        zones = list(touched)
        sampled, mesh = self.sampled, self.plants[0]
        place_m = np.take_along_axis(sampled.position_m[zones].T, sampled.place[1:, zones], axis=0)
        sampler = mesh.sampler(place_m.ravel())
        out = np.empty((len(self.plants), len(zones), len(tones)), dtype=np.complex128)
        _fill_displacement(
            self.K,
            self.C,
            self.M,
            self.spring,
            self.damper,
            mesh.actuator_dof,
            2 * np.pi * tones,
            weight.astype(np.complex128),
            np.ascontiguousarray(sampler.dof[:, 0]).reshape(place_m.shape),
            sampler.weight.reshape(*place_m.shape, 4),
            np.ascontiguousarray(sampled.stiffness_n_per_m[1:, zones]),
            np.ascontiguousarray(sampled.damping_n_s_per_m[1:, zones]),
            np.ascontiguousarray(sampled.mass_kg[1:, zones]),
            out,
        )
        size = abs(out) * ((2 * np.pi * tones) ** 2 / mesh.device.threshold.peak_m_per_s2(tones))
        powers: Array = (size**2).sum(axis=-1)
        return powers


def sample_bars(device: Device, sampled: SampledFingers) -> SampledBars | None:
    """One bar for each sampled case; None where no calibration says how well the device is known.

    What was fitted varies as the calibration has left it, the rest of bar and actuators within the device's spread.
    """
    if device.uncertainty is None:
        return None
    count = len(sampled.place) - 1
    scenarios = sample_scenarios(device, count, SEED)
    plants = tuple(assemble_bar(scenarios.device_of(i)) for i in range(1, count + 1))
    actuators = [plant.device.actuators for plant in plants]
    return SampledBars(
        plants=plants,
        sampled=sampled,
        K=np.stack([plant.K for plant in plants]),
        C=np.stack([plant.C for plant in plants]),
        M=np.stack([plant.M for plant in plants]),
        spring=np.array([[a.spring_force_n for a in each] for each in actuators]),
        damper=np.array([[a.damper_force_n_s for a in each] for each in actuators]),
    )


_BANDS = types.Array(types.float64, 3, "C", readonly=True)
_REAL = types.Array(types.float64, 1, "C", readonly=True)
_TABLE = types.Array(types.float64, 2, "C", readonly=True)
_INDEX = types.Array(types.int64, 1, "C", readonly=True)
_INDICES = types.Array(types.int64, 2, "C", readonly=True)
_WEIGHT = types.Array(types.complex128, 2, "C", readonly=True)
_SHAPE = types.Array(types.float64, 3, "C", readonly=True)
_OUT = types.Array(types.complex128, 3, "C")


@njit(
    types.void(
        _BANDS,
        _BANDS,
        _BANDS,
        _TABLE,
        _TABLE,
        _INDEX,
        _REAL,
        _WEIGHT,
        _INDICES,
        _SHAPE,
        _TABLE,
        _TABLE,
        _TABLE,
        _OUT,
    ),
    cache=True,
    parallel=True,
)
def _fill_displacement(K, C, M, spring, damper, dof, omega, weight, first, shape, k_finger, c_finger, m_finger, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (bar, finger, tone), metres: the dynamic stiffness with the fingers assembled, one load a tone."""
    bars, fingers, tones = out.shape
    size = K.shape[2]
    for b in prange(bars):
        for t in range(tones):
            w = omega[t]
            # Dynamic stiffness of the bar, both triangles: lu[column, FIRST_SUPER + row - column].
            lu = np.zeros((size, BAND_ROWS), dtype=np.complex128)
            for column in range(size):
                for k in range(min(column, BANDWIDTH) + 1):
                    value = complex(
                        K[b, BANDWIDTH - k, column] - w * w * M[b, BANDWIDTH - k, column],
                        w * C[b, BANDWIDTH - k, column],
                    )
                    lu[column, FIRST_SUPER - k] = value
                    lu[column - k, FIRST_SUPER + k] = value
            # The fingers are assembled, each through the shape functions of its element.
            for p in range(fingers):
                stiffness = complex(k_finger[b, p] - w * w * m_finger[b, p], w * c_finger[b, p])
                for i in range(4):
                    for j in range(4):
                        lu[first[b, p] + j, FIRST_SUPER + i - j] += stiffness * shape[b, p, i] * shape[b, p, j]
            # One load for all actuators of the tone, then the deflection under each finger.
            right = np.zeros((1, size), dtype=np.complex128)
            for a in range(dof.shape[0]):
                right[0, dof[a]] += complex(spring[b, a], w * damper[b, a]) * weight[t, a]
            eliminate(lu, right)
            for p in range(fingers):
                value = 0j
                for i in range(4):
                    value += shape[b, p, i] * right[0, first[b, p] + i]
                out[b, p, t] = value
