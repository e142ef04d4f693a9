"""Steady drives for fingers at any positions, solved from the receptances of the untouched bar when fingers come.

Theory of operation
-------------------
Each solve puts the fingers on the bar (engine.steady.loading): the standard finger, by which levels are stated, and
a few sampled cases of every finger's stiffness, damping, mass and exact position. It then maximises the expected
contrast, the weakest felt over the strongest quiet finger, each power averaged over the sampled cases, above the
wanted level of the standard felt fingers and within the amplitude limit (engine.steady.search). With nothing quiet it
maximises the share of kinetic energy in the zones that hold the felt fingers. All actuators play one frequency. No
bound is computed here; the tests compare optima with a Lagrangian bound (tests/engine/steady/bound.py).

Where no drive reaches the level, the loudest one is answered and `achieved` is False. An infinite level asks for it.

A drive that follows a finger keeps to its peak over frequency while that is good enough: the quiet finger feels a jump
to another frequency (docs/theory.md), and a few dB of contrast less it does not feel.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from base.errors import TactableError
from engine.device import Device
from engine.steady.cases import Deviations, FingerCases, cases_at, sample_deviations
from engine.steady.drive import SteadyDrive
from engine.steady.loading import fill_energies, fill_loaded, fill_powers
from engine.steady.receptances import Receptances
from engine.steady.search import find_drive
from engine.touch.placement import MOST_FINGERS

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Complex32 = NDArray[np.complex64]

_deviations = lru_cache(maxsize=4 * MOST_FINGERS)(sample_deviations)
LEVEL_TOLERANCE_DB = 1e-3
"""The same as in engine.table.levels; this package needs no table."""
_CASES, _FEW_CASES, _FEW_FINGERS = 8, 4, 4
_ALL = -1
"""Stands in place of the index of a frequency where all are searched."""
JUMP_HZ, FOLLOWED_HZ = 2.0, 8.0
"""A greater change of frequency is a jump; and that far a peak is followed from one position to the next."""
_EDGE_HZ = 2.0
"""What lies this close to the end of the search may be a slope, and no peak."""
_ENOUGH_DB, _LESS_DB = 18.0, 6.0
"""A peak is kept where it has this expected contrast, or at most that much less than the best peak."""


class SteadyError(TactableError, ValueError):
    """A placement that no drive can be solved for; the message names the finger and the value."""


class SteadySolver:
    """Solves placements on one device, one at a time: its buffers are its own, so threads need a solver each."""

    def __init__(self, device: Device, receptances: Receptances) -> None:
        self.device, self.frequency_hz, self.pitch_m = device, receptances.frequency_hz, receptances.pitch_m
        self._places = len(receptances.place_m)
        self._kept: dict[tuple[int, int], tuple[Single, Single]] = {}
        hz = receptances.frequency_hz
        omega = 2 * np.pi * hz
        self._omega: Single = omega.astype(np.float32)
        weight = omega**2 / receptances.threshold_m_per_s2
        self._drive = _split(receptances.drive * weight.astype(np.float32))
        self._point = _split(receptances.point)
        low_hz, high_hz = np.array([actuator.band_hz for actuator in device.actuators]).T
        slack_hz = 1e-9 * hz[:, None]
        self._usable = np.ascontiguousarray((hz[:, None] >= low_hz - slack_hz) & (hz[:, None] <= high_hz + slack_hz))
        self._middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
        self._half_m = np.array([zone.length_m / 2 for zone in device.zones])
        self._of_zone = np.stack([self._integral(zone.start_m, zone.stop_m) for zone in device.zones])
        self._of_bar = self._integral(0.0, device.bar.length_m)

    def prepare(self) -> None:
        """Load or compile the kernels and sample the cases, so that no later solve waits for that."""
        length_m = self.device.bar.length_m
        for fingers in range(1, MOST_FINGERS + 1):
            position_m = [length_m * (finger + 0.5) / fingers for finger in range(fingers)]
            self.solve(position_m, [finger == 0 for finger in range(fingers)], 0.0)

    def solve(
        self, positions_m: Sequence[float], felt: Sequence[bool], level_db: float, held_hz: float | None = None
    ) -> SteadyDrive:
        """The best drive for fingers at these positions, `felt` or else quiet, at a level in dB over threshold.

        An infinite level asks for the loudest drive. held_hz: frequency of the drive that these fingers have, which
        moved since; its peak is kept where that is good enough. Raises SteadyError for positions that are not on the
        bar, no felt finger, or more than MOST_FINGERS.
        """
        self._check(positions_m, felt, level_db)
        device = self.device
        deviations = self._deviations(len(positions_m))
        position_m = np.array(positions_m, dtype=np.float64)
        return self.solve_cases(
            cases_at(position_m, deviations, device.finger, device.bar.length_m), tuple(felt), level_db, held_hz
        )

    def solve_cases(
        self, cases: FingerCases, felt: tuple[bool, ...], level_db: float, held_hz: float | None = None
    ) -> SteadyDrive:
        """As `solve`, for given cases of the fingers."""
        limit, pitch_m = self.device.limits.amplitude, self.pitch_m
        impedance = np.ascontiguousarray(cases.impedance, dtype=np.float32)
        count, fingers = cases.position_m.shape
        between, loaded = self._buffers(count, fingers)
        fill_loaded(self._drive, self._point, self._omega, pitch_m, cases.position_m, impedance, between, loaded)
        is_felt = np.array(felt)
        felt_at = np.flatnonzero(is_felt)
        order = np.concatenate([felt_at, np.flatnonzero(~is_felt)])
        actuators, lines = self._drive.shape[1], self._drive.shape[3]
        is_share, is_flat = len(felt_at) == fingers, False
        if is_share:
            share = self._stretches(cases.position_m[0])
            is_flat = bool(np.allclose(share[0], share[1], rtol=1e-9, atol=0.0))
            forms = np.empty((2, actuators**2, lines))
            field = self._drive, self._point, self._omega, pitch_m, cases.position_m[0]
            fill_energies(*field, impedance[:1], loaded[0], share, forms)
        else:
            forms = np.empty((fingers, actuators**2, lines))
            fill_powers(loaded[1:], forms)
            forms = forms[order]
        wanted = 10 ** (level_db / 10) / limit**2
        hz, amplitude = self.frequency_hz, np.empty(actuators, dtype=np.complex128)
        power = np.empty((count, fingers))
        tail = self._usable, loaded, order, len(felt_at), np.ascontiguousarray(forms.transpose(2, 0, 1)), is_share
        objective, found = "localized factor" if is_share else "contrast", np.array([0.0, -1.0])
        if not (is_flat or np.isinf(level_db)):
            find_drive(hz, *tail, wanted, _ALL, found, amplitude, power)
        if held_hz is not None and not is_share and found[1] >= 0 and abs(found[0] - held_hz) > JUMP_HZ:
            kept, kept_amplitude, kept_power = np.array([0.0, -1.0]), np.empty_like(amplitude), np.empty_like(power)
            apart_hz = abs(hz - held_hz)
            near = self._usable & (apart_hz <= FOLLOWED_HZ + _EDGE_HZ)[:, None]
            find_drive(hz, near, *tail[1:], wanted, int(apart_hz.argmin()), kept, kept_amplitude, kept_power)
            enough = min(10 ** (_ENOUGH_DB / 10), found[1] * 10 ** (-_LESS_DB / 10))
            if kept[1] >= enough and abs(kept[0] - held_hz) <= FOLLOWED_HZ:
                found, amplitude, power = kept, kept_amplitude, kept_power
        if found[1] < 0:
            objective = "level"
            find_drive(hz, *tail, np.inf, _ALL, found, amplitude, power)
        found_hz, value = found.tolist()
        full_level_db = 10 * np.log10(power[0, felt_at].min() * limit**2)
        change_db = min(0.0, level_db - full_level_db)
        scale = limit * 10 ** (change_db / 20)
        sensed_db = 10 * np.log10(np.maximum(power, 1e-30)) + 20 * np.log10(scale)
        return SteadyDrive(
            frequency_hz=found_hz,
            amplitudes=tuple(np.minimum(abs(amplitude) * scale, limit).tolist()),
            phases_rad=tuple(np.angle(amplitude).tolist()),
            felt=tuple(felt),
            wanted_level_db=level_db,
            level_db=sensed_db[0],
            sampled_level_db=sensed_db[1:],
            objective=objective,
            value=_value_of(objective, value, limit),
            achieved=bool(np.isinf(level_db) or full_level_db >= level_db - LEVEL_TOLERANCE_DB),
        )

    def _deviations(self, fingers: int) -> Deviations:
        return _deviations(fingers, _CASES if fingers <= _FEW_FINGERS else _FEW_CASES)

    def _buffers(self, cases: int, fingers: int) -> tuple[Single, Single]:
        """Space for receptances between fingers and for responses, kept: fresh pages cost more than what fills them."""
        found = self._kept.get((cases, fingers))
        if found is None:
            _, actuators, parts, lines = self._drive.shape
            between = np.empty((fingers, fingers, parts, lines), dtype=np.float32)
            loaded = np.empty((cases, fingers, actuators, parts, lines), dtype=np.float32)
            found = self._kept[cases, fingers] = between, loaded
        return found

    def _stretches(self, position_m: Array) -> Array:
        """Weights (2, place) of power in the energy of the zones that hold the fingers, and of the bar."""
        held = sorted({int(k) for k in (abs(position_m[:, None] - self._middle_m) - self._half_m).argmin(axis=1)})
        return np.stack([self._of_zone[held].sum(axis=0), self._of_bar])

    def _integral(self, start_m: float, stop_m: float) -> Array:
        """Weights (place,) that integrate a function from its values at the places, cubic through four of them."""
        places, pitch_m = self._places, self.pitch_m
        weight = np.zeros(places)
        for piece in range(places - 1):
            low, high = max(start_m / pitch_m, piece), min(stop_m / pitch_m, piece + 1)
            if high > low:
                first = min(max(piece - 1, 0), places - 4)
                weight[first : first + 4] += _cubic_integral(low - first, high - first)
        return weight * pitch_m

    def _check(self, positions_m: Sequence[float], felt: Sequence[bool], level_db: float) -> None:
        length_m = self.device.bar.length_m
        if len(positions_m) != len(felt):
            raise SteadyError(f"{len(positions_m)} positions and {len(felt)} roles: give one role for each position")
        if not 0 < len(positions_m) <= MOST_FINGERS:
            raise SteadyError(f"{len(positions_m)} fingers: a drive is solved for one to {MOST_FINGERS}")
        if not any(felt):
            raise SteadyError("no finger is felt: a drive needs at least one that is")
        for number, at_m in enumerate(positions_m, 1):
            if not 0 <= at_m <= length_m:
                raise SteadyError(f"finger {number} at {1e3 * at_m:g} mm: the bar ends at {1e3 * length_m:g} mm")
        if np.isnan(level_db):
            raise SteadyError("the level is not a number; give dB above threshold, or inf for full scale")


def _value_of(objective: str, value: float, limit: float) -> float:
    """What was maximised: a share, or dB of contrast, or of the level at the amplitude limit."""
    if objective == "localized factor":
        return value
    return float(10 * np.log10(value)) + (20 * float(np.log10(limit)) if objective == "level" else 0.0)


def _split(values: Complex32) -> Single:
    """Real and imaginary parts (..., 2, frequency) of values (..., frequency)."""
    return np.ascontiguousarray(np.stack([values.real, values.imag], axis=-2), dtype=np.float32)


def _cubic_integral(low: float, high: float) -> Array:
    """Integrals (4,) from low to high of the cubics that are 1 at one of 0, 1, 2, 3 and 0 at the others."""
    node, half = np.arange(4.0), 0.5 * (high - low)
    # Gauss's rule of two points is exact for cubics.
    at = 0.5 * (low + high) + half / np.sqrt(3.0) * np.array([-1.0, 1.0])
    values = [np.prod([(at - o) / (k - o) for o in node if o != k], axis=0).sum() for k in node]
    return half * np.array(values)
