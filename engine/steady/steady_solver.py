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

from base.arrays import Array, Complex, Complex32, Integers, Mask, Points, Single
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
        low_hz, high_hz = np.array([actuator.band_hz for actuator in device.actuators]).T
        slack_hz = 1e-9 * hz[:, None]
        self._is_dense = len(hz) > len(device.sweep.frequency_hz)
        self._usable = np.ascontiguousarray((hz[:, None] >= low_hz - slack_hz) & (hz[:, None] <= high_hz + slack_hz))
        self._condensed = condensed = CondensedModes(modes)
        self._receptances = condensed.spread, condensed.line, (2 * np.pi * hz).astype(np.float32)
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
        is_felt, hz, impedance = np.array(felt), self.frequency_hz, np.ascontiguousarray(cases.impedance, np.float32)
        shape, loaded = self._load(cases, impedance)
        count, fingers, actuators, _, lines = loaded.shape
        is_share, is_flat = bool(is_felt.all()), False
        forms = np.empty((2 if is_share else fingers, actuators**2, lines))
        order = np.argsort(~is_felt, kind="stable")
        if is_share:
            held = held_zones(self.device, cases.position_m[0])
            share = np.stack([self._share[held].sum(axis=0), self._share[-1]])
            is_flat = bool(np.isclose(share[0].sum(), share[1].sum(), rtol=1e-9, atol=0.0))
            at = *self._field, self._at_points, shape[0], self._condensed.damper
            fill_energies(*at, *self._receptances, impedance[:1], loaded[0], share, forms)
        else:
            fill_powers(loaded[1:], forms)
            forms = forms[order]
        packed = np.ascontiguousarray(forms.transpose(2, 0, 1))

        def find(wanted: float, usable: Mask = self._usable, held: int = _ALL) -> tuple[float, float, Complex, Array]:
            """Frequency, what was maximised, amplitudes (actuator,) and powers (case, finger) of the best drive."""
            found, out = np.array([0.0, -1.0]), np.empty(actuators, dtype=np.complex128)
            power, roles = np.empty((count, fingers)), (order, int(is_felt.sum()))
            find_drive(hz, usable, loaded, *roles, packed, is_share, self._is_dense, wanted, held, found, out, power)
            return found[0].item(), found[1].item(), out, power

        limit, is_loudest = self.device.limits.amplitude, is_flat or bool(np.isinf(level_db))
        wanted = 10 ** (level_db / 10) / limit**2
        best = find(np.inf if is_loudest else wanted)
        if held_hz is not None and not (is_share or is_loudest) and best[1] >= 0 and abs(best[0] - held_hz) > JUMP_HZ:
            apart_hz = abs(hz - held_hz)
            near = self._usable & (apart_hz <= FOLLOWED_HZ + _EDGE_HZ)[:, None]
            kept = find(wanted, near, int(apart_hz.argmin()))
            enough = min(10 ** (_ENOUGH_DB / 10), best[1] * 10 ** (-_LESS_DB / 10))
            if kept[1] >= enough and abs(kept[0] - held_hz) <= FOLLOWED_HZ:
                best = kept
        if best[1] < 0 and not is_loudest:
            is_loudest, best = True, find(np.inf)
        objective = "level" if is_loudest else "localized factor" if is_share else "contrast"
        found_hz, value, amplitude, power = best
        return SteadyDrive.at_level(level_db, limit, found_hz, amplitude, power, felt, objective, value)

    def _load(self, cases: FingerCases, impedance: Single) -> tuple[Single, Single]:
        """Functions at the fingers (case, finger, function), and responses (case, finger, actuator, 2, frequency)."""
        modes, (count, fingers) = self._condensed, cases.position_m.shape
        reach_m = self.device.spread.reach_m or 1.0
        away = np.round((cases.position_m - cases.position_m[0]).T / reach_m, 6).astype(np.complex128)
        span = _span(away.tobytes(), fingers)
        shape = self._shapes(cases.position_m).reshape(count, fingers, -1)
        *space, loaded = self._buffers(count, fingers, span.shape[2])
        fill_loaded(shape, span, modes.drive, modes.damper, *self._receptances, impedance, *space, loaded)
        if count not in self._errors:
            self._errors[count] = self._sample_errors(count)
        if (errors := self._errors[count]) is not None:  # of surface and channels, beside those of the fingers
            below, weight, channels = errors
            response = loaded[..., 0, :] + 1j * loaded[..., 1, :]
            one, other = (np.take_along_axis(response, each[:, None, None], axis=3) for each in (below, below + 1))
            response = (one + weight[:, None, None] * (other - one)) * channels[:, None]
            loaded[..., 0, :], loaded[..., 1, :] = response.real, response.imag
        return shape, loaded

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


@lru_cache(maxsize=4 * MOST_FINGERS)  # away from edges, cases differ by the same
def _span(away: bytes, fingers: int) -> Single:
    """Orthonormal rows (finger, case, node) that span quadratic functions of what the cases' positions differ by."""
    apart = np.frombuffer(away, dtype=np.complex128).reshape(fingers, -1)
    x, y = apart.real, apart.imag
    powers = np.stack([np.ones_like(x), x, x * x, y, x * y, y * y], axis=-1)
    vectors, sizes, _ = np.linalg.svd(powers, full_matrices=False)
    nodes = int((sizes > _FLAT * sizes[:, :1]).sum(axis=1).max())
    return np.ascontiguousarray(vectors[:, :, :nodes], dtype=np.float32)
