"""Baselines for clicks: acoustic contrast control in a time window, and the steady drive switched on and off."""

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from base.arrays import Array, Integers
from engine.steady import SteadyDrive
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, SAMPLE_RATE_HZ, make_tones
from precompute.clicks.click_solver import Click, ClickSolver

_PLANTS = 41  # plants that the energies are averaged over
_REGULAR = 1e-6  # regularisation, relative to the mean quiet energy; without it the quotient is decided by rounding


def energy_contrast(solver: ClickSolver, placement: Placement) -> Array:
    """Waveform of the greatest ratio of felt energy during the click to quiet energy at all times.

    Acoustic contrast control in the time domain: the leading generalised eigenvector over the weights of the tones,
    with weighted energies averaged over the scenarios. Without quiet fingers the denominator is the drive's energy.
    """
    length_s = solver.options.length_s
    tones = make_tones(solver.device, length_s, solver.options.crowding)
    played = solver.plants_of(placement.position_m).pool.first(_PLANTS).play_each(tones)
    felt, quiet = placement.felt, placement.quiet
    numerator = _energy(played[:, felt, : round(length_s * EVALUATION_RATE_HZ)])
    denominator = _energy(played[:, quiet]) if quiet else _drive_energy(tones.wave, tones.actuator)
    mean = np.trace(denominator) / len(denominator)
    _, vectors = scipy.linalg.eigh(numerator, denominator + _REGULAR * mean * np.eye(len(denominator)))
    return tones.waveform(np.asarray(vectors[:, -1], dtype=np.float64))


def gated_drive(solver: ClickSolver, placement: Placement, drives: Sequence[SteadyDrive]) -> Array:
    """The steady drive switched on for that long within the slew of the device's limits; of all levels the best."""
    gated = [gate(drive, solver.options.length_s, solver.device.limits.slew_per_s) for drive in drives]
    return max(gated, key=lambda moved: solver.evaluate(placement, moved).evaluation.felt.low_db)


def gate(drive: SteadyDrive, length_s: float, slew_per_s: float) -> Array:
    """Base displacements (actuator, time) of a drive that ramps up at the start and down to 0 at length_s."""
    time_s = np.arange(round(length_s * SAMPLE_RATE_HZ) + 1) / SAMPLE_RATE_HZ
    envelope = np.minimum(1.0, np.minimum(time_s, time_s[-1] - time_s) * slew_per_s)
    turn = 2 * np.pi * np.outer(drive.frequencies_hz, time_s) + np.array(drive.phases_rad)[:, None]
    return np.array(drive.amplitudes)[:, None] * envelope * np.sin(turn)


ENERGY_CONTRAST, GATED_DRIVE = "energy contrast", "gated steady drive"
BASELINES = (ENERGY_CONTRAST, GATED_DRIVE)  # names of the baselines


def solve_baseline(solver: ClickSolver, placement: Placement, drives: Sequence[SteadyDrive], name: str) -> Click:
    """A baseline scaled to the limits and the quiet level, and evaluated. drives: steady drives, one for each level."""
    is_energy = name == ENERGY_CONTRAST
    waveform = energy_contrast(solver, placement) if is_energy else gated_drive(solver, placement, drives)
    return solver.evaluate(placement, waveform)


def _energy(course: Array) -> Array:
    """Gram matrix (tone, tone) of time courses (scenario, finger, time, tone)."""
    rows = course.reshape(-1, course.shape[-1])
    return rows.T @ rows


def _drive_energy(wave: Array, actuator: Integers) -> Array:
    return (wave @ wave.T) * (actuator[:, None] == actuator)
