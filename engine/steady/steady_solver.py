"""Steady drives for fingers at any positions, solved from the modes of the untouched surface when fingers come.

Theory of operation
-------------------
Each solve puts the fingers on the surface (engine.steady.loading): the standard finger, by which levels are stated, and
a few sampled cases of every finger's stiffness, damping, mass and exact position, each with a surface and channels of
its own where the device's spread has those. It then maximises the expected
contrast, the weakest felt over the strongest quiet finger, each power averaged over the sampled cases, above the
wanted level of the standard felt fingers and within the amplitude limit (engine.steady.drive_search). With nothing
quiet it maximises the share of kinetic energy in the zones that hold the felt fingers. All actuators play one
frequency. How far from the best a drive is, is not told here: the tests compare drives with a Lagrangian bound
(tests/engine/steady/bound.py) and with a patient search (tests/studies/physics/steady_optimum.py).

Where no drive reaches the level, the loudest one is answered and `achieved` is False. An infinite level asks for it.

A drive that follows a finger keeps to its peak over frequency while that is good enough: the quiet finger feels a jump
to another frequency (docs/theory.md), and a few dB of contrast less it does not feel.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from base.arrays import Complex32, Integers, Points, Single
from base.errors import TactableError
from base.points import is_within, point_text
from engine.device import Device
from engine.steady.cases import FingerCases, MeasuredFinger, PlantErrors, axes_of, cases_at, sample_deviations
from engine.steady.drive_search import find_drive
from engine.steady.loading import fill_energies, fill_loaded, fill_powers, fill_shapes
from engine.steady.modes import CondensedModes, Modes, energy_points, held_zones
from engine.steady.steady_drive import SteadyDrive
from engine.touch.placement import MOST_FINGERS

_deviations = lru_cache(maxsize=4 * MOST_FINGERS)(sample_deviations)
LEVEL_TOLERANCE_DB = 1e-3  # the same as in engine.table.levels; this package needs no table
_CASES, _FEW_CASES, _FEW_FINGERS = 8, 4, 4
_FLAT = 1e-9  # a smaller singular value is rounding: bars have no y
_ALL = -1  # stands in place of the index of a frequency where all are searched
JUMP_HZ, FOLLOWED_HZ = 2.0, 8.0  # a greater change of frequency is a jump; peaks are followed as far as the second
_EDGE_HZ = 2.0  # what lies this close to the end of the search may be a slope, and no peak
_ENOUGH_DB, _LESS_DB = 18.0, 6.0  # a peak is kept with this expected contrast, or at most that much less than the best


class SteadyError(TactableError, ValueError):
    """A placement that no drive can be solved for; the message names the finger and the value."""


class SteadySolver:
    """Solves placements on one device, one at a time: its buffers are its own, so threads need a solver each."""

    def __init__(self, device: Device, modes: Modes) -> None:
        self.device, self.frequency_hz, hz = device, modes.frequency_hz, modes.frequency_hz
        self._errors: dict[int, tuple[Integers, Single, Complex32] | None] = {}  # by the number of cases
        self._kept: dict[tuple[int, ...], list[Single]] = {}
        self._omega: Single = (2 * np.pi * hz).astype(np.float32)
        low_hz, high_hz = np.array([actuator.band_hz for actuator in device.actuators]).T
        slack_hz = 1e-9 * hz[:, None]
        self._is_dense = len(hz) > len(device.sweep.frequency_hz)
        self._usable = np.ascontiguousarray((hz[:, None] >= low_hz - slack_hz) & (hz[:, None] <= high_hz + slack_hz))
        self._condensed = condensed = CondensedModes(modes)
        points_m, self._share = energy_points(device)
        at, actuators = self._shapes(points_m), len(device.actuators)
        functions = len(condensed.drive)
        parts = -1, actuators, 2, len(hz)
        self._field = tuple((at[:, :functions] @ each).reshape(parts) for each in (condensed.drive, condensed.damper))
        self._at_points = np.ascontiguousarray(at[:, functions:])

    def prepare(self) -> None:
        """Load or compile the kernels and sample the cases, so that no later solve waits for that."""
        corner_m = self.device.surface.corner_m
        for fingers in range(1, MOST_FINGERS + 1):
            position_m = [corner_m * (finger + 0.5) / fingers for finger in range(fingers)]
            self.solve(position_m, [finger == 0 for finger in range(fingers)], 0.0)

    def solve(
        self,
        positions_m: Sequence[complex],
        felt: Sequence[bool],
        level_db: float,
        held_hz: float | None = None,
        measured: Sequence[MeasuredFinger | None] = (),
    ) -> SteadyDrive:
        """The best drive for fingers at these positions, `felt` or else quiet, at a level in dB over threshold.

        An infinite level asks for the loudest drive. held_hz: frequency of the drive that these fingers have, which
        moved since; its peak is kept where that is good enough. measured: what is known of each finger. Raises
        SteadyError for positions that are not on the bar, no felt finger, or more than MOST_FINGERS.
        """
        self._check(positions_m, felt, level_db)
        device = self.device
        fingers = len(positions_m)
        count = _CASES if fingers <= _FEW_FINGERS else _FEW_CASES
        deviations = _deviations(fingers, count, axes_of(device.surface.corner_m))
        cases = cases_at(np.array(positions_m), deviations, device, measured)
        return self.solve_cases(cases, tuple(felt), level_db, held_hz)

    def solve_cases(
        self, cases: FingerCases, felt: tuple[bool, ...], level_db: float, held_hz: float | None = None
    ) -> SteadyDrive:
        """As `solve`, for given cases of the fingers."""
        limit, modes = self.device.limits.amplitude, self._condensed
        impedance = np.ascontiguousarray(cases.impedance, dtype=np.float32)
        count, fingers = cases.position_m.shape
        reach_m = self.device.spread.reach_m or 1.0
        away = np.round((cases.position_m - cases.position_m[0]).T / reach_m, 6).astype(np.complex128)
        span = _span(away.tobytes(), fingers)
        shape = self._shapes(cases.position_m).reshape(count, fingers, -1)
        nodes, taken, between, loaded = self._buffers(count, fingers, span.shape[2])
        field = modes.spread, modes.line, self._omega
        fill_loaded(shape, span, modes.drive, modes.damper, *field, impedance, nodes, taken, between, loaded)
        self._disturb(loaded)
        is_felt = np.array(felt)
        felt_at = np.flatnonzero(is_felt)
        order = np.concatenate([felt_at, np.flatnonzero(~is_felt)])
        actuators, lines = loaded.shape[2], loaded.shape[4]
        is_share, is_flat = len(felt_at) == fingers, False
        if is_share:
            held = held_zones(self.device, cases.position_m[0])
            share = np.stack([self._share[held].sum(axis=0), self._share[-1]])
            is_flat = bool(np.isclose(share[0].sum(), share[1].sum(), rtol=1e-9, atol=0.0))
            forms = np.empty((2, actuators**2, lines))
            at = *self._field, self._at_points, shape[0], modes.damper
            fill_energies(*at, *field, impedance[:1], loaded[0], share, forms)
        else:
            forms = np.empty((fingers, actuators**2, lines))
            fill_powers(loaded[1:], forms)
            forms = forms[order]
        wanted = 10 ** (level_db / 10) / limit**2
        hz, amplitude = self.frequency_hz, np.empty(actuators, dtype=np.complex128)
        power = np.empty((count, fingers))
        packed = np.ascontiguousarray(forms.transpose(2, 0, 1))
        tail = self._usable, loaded, order, len(felt_at), packed, is_share, self._is_dense
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

    def _disturb(self, loaded: Single) -> None:
        """Put errors of surface and channels, if any, into the cases (case, finger, actuator, 2, frequency)."""
        if len(loaded) not in self._errors:
            self._errors[len(loaded)] = self._sample_errors(len(loaded))
        errors = self._errors[len(loaded)]
        if errors is None:
            return
        below, weight, channels = errors
        response = loaded[..., 0, :] + 1j * loaded[..., 1, :]
        one, other = (np.take_along_axis(response, each[:, None, None], axis=3) for each in (below, below + 1))
        response = (one + weight[:, None, None] * (other - one)) * channels[:, None]
        loaded[..., 0, :], loaded[..., 1, :] = response.real, response.imag

    def _sample_errors(self, cases: int) -> tuple[Integers, Single, Complex32] | None:
        errors = PlantErrors.sample(self.device, cases)
        if errors is None:
            return None
        below, weight = errors.lines(self.frequency_hz)
        return below, weight.astype(np.float32), errors.channels(self.frequency_hz).astype(np.complex64)

    def _shapes(self, points_m: Points) -> Single:
        """Functions (point, function) at points."""
        along, across = self._condensed.steps(points_m.ravel())
        out = np.empty((len(along), self._condensed.grid.shape[2]), dtype=np.float32)
        fill_shapes(along, across, self._condensed.grid, out)
        return out

    def _buffers(self, cases: int, fingers: int, nodes: int) -> list[Single]:
        """Space of `fill_loaded`, kept: fresh pages cost more than what fills them."""
        found = self._kept.get((cases, fingers, nodes))
        if found is None:
            each = len(self.device.actuators), 2, len(self.frequency_hz)
            shapes = (
                (2, fingers, nodes, int(np.prod(each))),
                (fingers, *each),
                (fingers, fingers, *each[1:]),
                (cases, fingers, *each),
            )
            found = self._kept[cases, fingers, nodes] = [np.empty(shape, dtype=np.float32) for shape in shapes]
        return found

    def _check(self, positions_m: Sequence[complex], felt: Sequence[bool], level_db: float) -> None:
        corner_m = self.device.surface.corner_m
        if len(positions_m) != len(felt):
            raise SteadyError(f"{len(positions_m)} positions and {len(felt)} roles: give one role for each position")
        if not 0 < len(positions_m) <= MOST_FINGERS:
            raise SteadyError(f"{len(positions_m)} fingers: a drive is solved for one to {MOST_FINGERS}")
        if not any(felt):
            raise SteadyError("no finger is felt: a drive needs at least one that is")
        for number, at_m in enumerate(positions_m, 1):
            if not is_within(at_m, corner_m):
                raise SteadyError(f"finger {number} at {point_text(at_m)}: the surface ends at {point_text(corner_m)}")
        if np.isnan(level_db):
            raise SteadyError("the level is not a number; give dB above threshold, or inf for full scale")


def _value_of(objective: str, value: float, limit: float) -> float:
    """What was maximised: a share, or dB of contrast, or of the level at the amplitude limit."""
    if objective == "localized factor":
        return value
    return float(10 * np.log10(value)) + (20 * float(np.log10(limit)) if objective == "level" else 0.0)


@lru_cache(maxsize=4 * MOST_FINGERS)  # away from edges, cases differ by the same
def _span(away: bytes, fingers: int) -> Single:
    """Orthonormal rows (finger, case, node) that span quadratic functions of what the cases' positions differ by."""
    apart = np.frombuffer(away, dtype=np.complex128).reshape(fingers, -1)
    x, y = apart.real, apart.imag
    powers = np.stack([np.ones_like(x), x, x * x, y, x * y, y * y], axis=-1)
    vectors, sizes, _ = np.linalg.svd(powers, full_matrices=False)
    nodes = int((sizes > _FLAT * sizes[:, :1]).sum(axis=1).max())
    return np.ascontiguousarray(vectors[:, :, :nodes], dtype=np.float32)
