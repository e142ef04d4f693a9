"""Other ways to a click, by name, for comparison: energy contrast in a window, the steady drive gated."""

from collections.abc import Callable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from engine.table import Entry
from engine.touch import ZoneState
from precompute.clicks.basis import LOOK_RATE_HZ, PLAY_RATE_HZ, make_tones
from precompute.clicks.design import fingers_of
from precompute.clicks.solver import Click, ClickSolver
from precompute.entries.prediction import States, touched_zones
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble

Array = NDArray[np.float64]

_REGULAR = 1e-6
"""Of the mean quiet energy, added to every tone's: without it the quotient rests on rounding."""


def energy_contrast(solver: ClickSolver, states: States, length_s: float) -> Array:
    """Most weighted energy under felt fingers during the click over that under quiet ones at all times.

    Energies averaged over the scenarios; the greatest generalised eigenvalue over the weights of the tones (acoustic
    contrast control in the time domain). With nothing quiet: over the energy of the displacement.
    """
    options = solver.options
    tones = make_tones(solver.device, length_s, options.crowding)
    played = solver.plants_of(touched_zones(states)).optimised.play_each(tones)
    felt, quiet = (fingers_of(states, kind) for kind in (ZoneState.FELT, ZoneState.QUIET))
    numerator = _energy(played[:, felt, : round(length_s * LOOK_RATE_HZ)])
    denominator = _energy(played[:, quiet]) if quiet else _drive_energy(tones.wave, tones.actuator)
    mean = np.trace(denominator) / len(denominator)
    _, vectors = scipy.linalg.eigh(numerator, denominator + _REGULAR * mean * np.eye(len(denominator)))
    return tones.waveform(np.asarray(vectors[:, -1], dtype=np.float64))


def gated_drive(solver: ClickSolver, states: States, length_s: float) -> Array:
    """A steady entry switched on for that long with the ramp of the device's limits: of its levels the best so."""
    entries = EntrySolver(assemble(solver.device)).solve(states)
    gated = [gate(entry, length_s, solver.device.limits.slew_per_s) for entry in entries]
    return max(gated, key=lambda drive: solver.judge(states, length_s, drive, "").verdict.felt.low_db)


def gate(entry: Entry, length_s: float, slew_per_s: float) -> Array:
    """Base displacements (actuator, time) of a drive that ramps up at once and is silent again after length_s."""
    time_s = np.arange(round(length_s * PLAY_RATE_HZ) + 1) / PLAY_RATE_HZ
    envelope = np.minimum(1.0, np.minimum(time_s, time_s[-1] - time_s) * slew_per_s)
    turn = 2 * np.pi * np.outer(entry.frequencies_hz, time_s) + np.array(entry.phases_rad)[:, None]
    displacement: Array = np.array(entry.amplitudes)[:, None] * envelope * np.sin(turn)
    return displacement


BASELINES: dict[str, Callable[[ClickSolver, States, float], Array]] = {
    "energy contrast": energy_contrast,
    "gated steady drive": gated_drive,
}
"""Objectives that a click can be compared with: functions of solver, states and length to a waveform."""


def solve_baseline(solver: ClickSolver, states: States, name: str) -> Click:
    """The waveform of BASELINES[name], of the first length, as loud as limits and quiet level allow, judged alike."""
    length_s = solver.options.lengths_s[0]
    return solver.judge(states, length_s, BASELINES[name](solver, states, length_s), name)


def _energy(course: Array) -> Array:
    """Shape (tone, tone): products of the tones' courses (scenario, finger, time, tone), summed."""
    rows = course.reshape(-1, course.shape[-1])
    energy: Array = rows.T @ rows
    return energy


def _drive_energy(wave: Array, actuator: NDArray[np.int64]) -> Array:
    energy: Array = (wave @ wave.T) * (actuator[:, None] == actuator)
    return energy
