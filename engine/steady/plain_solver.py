"""Steady drives for fingers at any positions in NumPy alone: what plays until kernels are compiled on a machine.

Theory of operation
-------------------
Objective, cases of fingers and the rule of the level are those of engine.steady.steady_solver, which needs compiled
kernels; other surfaces and channels than the standard one it does not know. This solver looks at the frequencies of the
search only, and not between them. At each of them it takes the drive of the greatest ratio of two quadratic forms, a
generalised eigenvector; several felt or quiet fingers are weighted against each other in a few rounds, the weakest felt
and the strongest quiet one more each time. Where that drive is too soft for the wanted level, a part of the squared
amplitude is added to the form below the fraction: the more of it, the louder and the less localized the drive. The
ratio without that part is an upper bound, so most frequencies are left out before this is tried. A solve takes some ten
milliseconds, and gives about a decibel of contrast away.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from base.arrays import Array, Complex, Mask
from engine.device import Device
from engine.steady.cases import FingerCases, MeasuredFinger, axes_of, cases_at, sample_deviations
from engine.steady.modes import Modes, energy_points, held_zones
from engine.steady.steady_drive import PlainLoading, SteadyDrive
from engine.touch.placement import MOST_FINGERS

_deviations = lru_cache(maxsize=MOST_FINGERS)(sample_deviations)
_CASES = 8
_ROUNDS = 5  # of 36 placements of 3 or 4 fingers 2 lose 0.3 dB (mean), 10 win 0.1 in 1.6 times the time
_PARTS = np.geomspace(1e-3, 1e4, 15)  # added parts of the squared amplitude, relative to the form below the fraction
_TRIED = 48  # most frequencies at which a louder drive is looked for
_TINY = 1e-9


class PlainSolver:
    """Solves placements on one device, as engine.steady.steady_solver.SteadySolver does, without a compiled kernel."""

    def __init__(self, device: Device, modes: Modes) -> None:
        self.device = device
        self._frequency_hz = hz = modes.frequency_hz
        low_hz, high_hz = np.array([actuator.band_hz for actuator in device.actuators]).T
        slack_hz = 1e-9 * hz
        self._usable = (hz >= low_hz[:, None] - slack_hz) & (hz <= high_hz[:, None] + slack_hz)
        self._loading = PlainLoading(modes)
        self._points_m, self._share = energy_points(device)
        self._untouched = self._loading.untouched(self._points_m).swapaxes(0, 1) * self._usable.T[:, None]

    def prepare(self) -> None:
        """Nothing: there is nothing to load."""

    def solve(
        self,
        positions_m: Sequence[complex],
        felt: Sequence[bool],
        level_db: float,
        held_hz: float | None = None,  # noqa: ARG002  # the frequency may jump where a finger moves
        measured: Sequence[MeasuredFinger | None] = (),
    ) -> SteadyDrive:
        """A drive for fingers at these points, at least one of them `felt`, at a level over threshold.

        level_db: in dB; an infinite level asks for the loudest drive.
        """
        position_m, is_felt = np.array(positions_m), np.array(felt, dtype=np.bool_)
        limit = self.device.limits.amplitude
        deviations = _deviations(len(position_m), _CASES, axes_of(self.device.surface.corner_m))
        cases = cases_at(position_m, deviations, self.device, measured)
        loaded = self._loading.loaded(cases) * self._usable.T[:, None]
        rows = loaded[0][:, is_felt]
        index, amplitude, value, objective = -1, np.zeros(loaded.shape[3], dtype=np.complex128), 0.0, "level"
        if np.isfinite(level_db):
            objective = "localized factor" if is_felt.all() else "contrast"
            above, below = self._forms(cases, loaded, is_felt)
            index, amplitude, value = _greatest_ratio(above, below, rows, 10 ** (level_db / 10) / limit**2)
        if index < 0:
            objective, (index, amplitude, value) = "level", _loudest(rows)
        amplitude = amplitude * self._usable[:, index]
        amplitude /= abs(amplitude).max()
        power, found_hz = abs(loaded[:, index] @ amplitude) ** 2, float(self._frequency_hz[index])
        return SteadyDrive.at_level(level_db, limit, found_hz, amplitude, power, felt, objective, value)

    def _forms(self, cases: FingerCases, loaded: Complex, is_felt: Mask) -> tuple[Complex, Complex]:
        """The forms (form, frequency, actuator, actuator) above and below the fraction."""
        if not is_felt.all():
            power = _squares(loaded[1:]).mean(axis=0).swapaxes(0, 1)
            return power[is_felt], power[~is_felt]
        standard = cases.position_m[0]
        pushed = self._loading.receptances(self._points_m, standard) * self._loading.impedance(cases)[0][:, None]
        power = _squares(self._untouched - pushed @ loaded[0])
        held = self._share[held_zones(self.device, standard)].sum(axis=0)
        return tuple(np.einsum("p,kpab->kab", part, power)[None] for part in (held, self._share[-1]))


def _squares(response: Complex) -> Complex:
    """The form a -> |response a|^2 (..., actuator, actuator) of responses (..., actuator)."""
    return response[..., :, None].conj() * response[..., None, :]


def _greatest_ratio(above: Complex, below: Complex, rows: Complex, wanted: float) -> tuple[int, Complex, float]:
    """Index of a frequency, its drive (actuator,) and its ratio; index -1 where no drive is loud enough.

    above, below (form, frequency, actuator, actuator): the weakest over the strongest is maximised. rows (frequency,
    finger, actuator): responses under the felt standard fingers, whose power over that of the strongest actuator is to
    be `wanted` at least.
    """
    drive = _balanced(above, below)
    ratio = _ratio(above, below, drive)
    is_loud = _loudness(rows, drive) >= wanted
    best = int(np.where(is_loud, ratio, -1.0).argmax())
    found = (best, drive[best], float(ratio[best])) if is_loud[best] else (-1, drive[best], -1.0)
    left = np.flatnonzero(~is_loud & (ratio > found[2]))
    tried = left[np.argsort(-ratio[left], kind="stable")[:_TRIED]]
    if not len(tried):
        return found
    actuators = drive.shape[1]
    size = np.einsum("dkaa->k", below[:, tried]).real / (len(below) * actuators)
    for part in _PARTS:
        added = (part * size)[:, None, None] * np.eye(actuators)
        louder = _balanced(above[:, tried], below[:, tried] + added)
        reached = np.where(
            _loudness(rows[tried], louder) >= wanted, _ratio(above[:, tried], below[:, tried], louder), -1
        )
        best = int(reached.argmax())
        if reached[best] > found[2]:
            found = int(tried[best]), louder[best], float(reached[best])
    return found


def _balanced(above: Complex, below: Complex) -> Complex:
    """The drive (frequency, actuator) of about the greatest ratio, weakest over strongest, at each frequency."""
    for_above, for_below = np.ones(above.shape[:2]), np.ones(below.shape[:2])
    best, drive = np.full(above.shape[1], -1.0), np.zeros(above.shape[1:3], dtype=np.complex128)
    for _ in range(1 if len(above) == len(below) == 1 else _ROUNDS):
        found = _dominant(_weighted(for_above, above), _weighted(for_below, below))
        powers, others = _powers(above, found), _powers(below, found)
        ratio = powers.min(axis=0) / np.maximum(others.max(axis=0), 1e-300)
        drive[ratio > best] = found[ratio > best]
        best = np.maximum(best, ratio)
        for_above *= np.sqrt(powers.mean(axis=0) / np.maximum(powers, 1e-300)).clip(0.1, 10.0)
        for_below *= np.sqrt(others / np.maximum(others.mean(axis=0), 1e-300)).clip(0.1, 10.0)
    return drive


def _weighted(weight: Array, forms: Complex) -> Complex:
    return np.einsum("ik,ikab->kab", weight, forms)


def _dominant(above: Complex, below: Complex) -> Complex:
    """The drive (frequency, actuator) of the greatest ratio of two forms (frequency, actuator, actuator)."""
    actuators = above.shape[1]
    size = np.maximum(np.einsum("kaa->k", below).real, 1e-300)
    floor = (_TINY * size)[:, None, None] * np.eye(actuators)
    inverse = np.linalg.inv(np.linalg.cholesky(below + floor))
    turned = inverse @ above @ inverse.conj().swapaxes(1, 2)
    vectors = np.linalg.eigh(turned)[1]
    return (inverse.conj().swapaxes(1, 2) @ vectors[:, :, -1:])[:, :, 0]


def _powers(forms: Complex, drive: Complex) -> Array:
    """The power (form, frequency) of a drive in each form."""
    return np.einsum("ka,ikab,kb->ik", drive.conj(), forms, drive).real


def _ratio(above: Complex, below: Complex, drive: Complex) -> Array:
    """The weakest power over the strongest (frequency,)."""
    return _powers(above, drive).min(axis=0) / np.maximum(_powers(below, drive).max(axis=0), 1e-300)


def _loudness(rows: Complex, drive: Complex) -> Array:
    """Power under the weakest felt finger, the strongest actuator at 1 (frequency,)."""
    power = (abs(np.einsum("kfa,ka->kf", rows, drive)) ** 2).min(axis=1)
    return power / np.maximum(abs(drive).max(axis=1) ** 2, 1e-300)


def _loudest(rows: Complex) -> tuple[int, Complex, float]:
    """Index of a frequency, its loudest drive with all actuators at 1, and its power under the weakest felt finger."""
    weight, best, drive = np.ones(rows.shape[:2]), np.full(len(rows), -1.0), np.zeros_like(rows[:, 0])
    for _ in range(1 if rows.shape[1] == 1 else _ROUNDS):
        together = np.einsum("kf,kfa,kfb->kab", weight, rows.conj(), rows)
        vector = np.linalg.eigh(together)[1][:, :, -1]
        found = np.where(abs(vector) > 0, vector / np.maximum(abs(vector), 1e-300), 0)
        loudness = _loudness(rows, found)
        drive[loudness > best] = found[loudness > best]
        best = np.maximum(best, loudness)
        power = abs(np.einsum("kfa,ka->kf", rows, found)) ** 2
        weight *= (power.mean(axis=1, keepdims=True) / np.maximum(power, 1e-300)).clip(0.1, 10.0)
    index = int(best.argmax())
    return index, drive[index], float(best[index])
