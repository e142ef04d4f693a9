"""Figures of a drive with fingers on the bar: shares, peaks, accelerations and levels, for every sampled case."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex
from precompute.model.plant import Plant
from precompute.model.response import by_tone, solve_response
from precompute.model.steady import SteadyState, steady_state_of
from precompute.sampling.fingers import SampledFingers

_STEPS = 32  # about, of the places along a zone, are looked at for the range of its peak


@dataclass(frozen=True)
class DriveFigures:
    """Steady state of one drive with fingers in the touched zones.

    standard: every zone's figures, standard fingers at the middles. share, peak (case, zone): with each case, the
    standard one first. acceleration (m/s^2) and power over threshold, each (case, finger): under the fingers; tones of
    different frequencies add as magnitudes in the first and as powers in the second.
    """

    standard: SteadyState
    share: Array
    peak: Array
    acceleration: Array
    power: Array


def compute_figures(
    plant: Plant, sampled: SampledFingers, touched: Sequence[int], frequency_hz: Array, amplitude: Complex
) -> DriveFigures:
    """Figures of the drive, frequency_hz and amplitude (actuator,) as fractions of full scale."""
    tones, weight = by_tone(frequency_hz, amplitude)
    field = _loaded_fields(plant, sampled, list(touched), tones, weight)
    omega = 2 * np.pi * tones
    zones = np.array(touched, dtype=np.int64)
    here_m = np.take_along_axis(sampled.position_m[zones].T, sampled.place[:, zones], axis=0)
    under = _sample_each(plant, field, here_m) * (omega**2)[:, None, None]
    share, peak = _zone_figures(plant, field, omega)
    return DriveFigures(
        standard=steady_state_of(plant, tones, field[:, 0]),
        share=share,
        peak=peak,
        acceleration=np.abs(under).sum(axis=0),
        power=(np.abs(under / plant.device.threshold.peak_m_per_s2(tones)[:, None, None]) ** 2).sum(axis=0),
    )


def _loaded_fields(plant: Plant, sampled: SampledFingers, zones: list[int], tones: Array, weight: Complex) -> Complex:
    """Displacement (tone, case, degree of freedom) under the drive; fingers are a low-rank update at their points."""
    actuators = weight.shape[1]
    response = solve_response(plant, tones, sampled.position_m.ravel()).displacement_m
    free = np.einsum("ta,tad->td", weight, response[:, :actuators])
    pushed = response[:, actuators:]
    place = np.array(zones, dtype=np.int64) * sampled.position_m.shape[1] + sampled.place[:, zones]
    at_places = plant.sampler(sampled.position_m.ravel()).sample(response)
    stiffness = sampled.dynamic_stiffness(tones)[:, :, zones]
    receptance = at_places[:, actuators:][:, place[:, :, None], place[:, None, :]]
    moved = at_places[:, :actuators].transpose(0, 2, 1) @ weight[:, :, None]
    under = np.linalg.solve(np.eye(len(zones)) + receptance * stiffness[:, :, None, :], moved[:, place])[..., 0]
    force = np.zeros((len(tones), len(place), at_places.shape[2]), dtype=np.complex128)
    np.put_along_axis(force, np.broadcast_to(place, under.shape), -stiffness * under, axis=2)
    return free[:, None] + force @ pushed


def _sample_each(plant: Plant, field: Complex, position_m: Array) -> Complex:
    """Field (tone, case, degree of freedom) at positions of its own for each case (case, place)."""
    sampler = plant.sampler(position_m.ravel())
    columns, weights = (each.reshape(*position_m.shape, -1) for each in (sampler.dof, sampler.weight))
    case = np.arange(len(position_m))[:, None, None]
    return np.einsum("tkpi,kpi->tkp", field[:, case, columns], weights)


def _zone_figures(plant: Plant, field: Complex, omega: Array) -> tuple[Array, Array]:
    """Share of the kinetic energy and peak acceleration, each (case, zone)."""
    columns = np.ascontiguousarray(np.moveaxis(field, 1, 0)[:, :, None])
    energy = np.array([omega**2 @ plant.gram(column)[:, :, 0, 0].real for column in columns])
    # Magnitudes of the tones are added at each place (paper eq. (8)).
    every = max(1, plant.zone_places_m.shape[-1] // _STEPS)
    looked_at = plant.sampler(plant.zone_places_m[:, ::every, ::every].ravel())
    level = np.tensordot(omega**2, abs(looked_at.sample(field)), 1)
    peak = level.reshape(len(level), len(plant.device.zones), -1).max(axis=2)
    return energy[:, :-1] / energy.sum(axis=1, keepdims=True), peak
