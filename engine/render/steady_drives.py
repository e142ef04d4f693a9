"""Steady drives as commands: solved for the exact positions when they are wanted, clamped, encoded, and remembered.

Optima are sharp and responses are smooth (docs/theory.md#steady-drives-at-positions), so no drive is tabulated: the
table holds the modes, and a solve takes less time than a report of most digitizers. Until the kernels of the
solver are compiled, once on a machine, a page solves in NumPy (engine.steady.plain_solver). Zones play rows of the
table's sweep, which are looked up (engine.table.best_rows).
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from engine.device import Device
from engine.render.limits import clamp, encode_scaled
from engine.render.renderer import SILENCE, DriveCommand, Rendered
from engine.steady import Modes, SteadyDrive
from engine.steady.cases import MeasuredFinger
from engine.table.best_rows import BestRow, BestRows, combination_of
from engine.touch import Placement
from engine.touch.finger_tracker import ZoneFinder
from firmware_link.host.link_values import Capabilities

if TYPE_CHECKING:
    from engine.steady.plain_solver import PlainSolver
    from engine.steady.steady_solver import SteadySolver

_SAME_M = 8e-3  # a measured finger that is nearer than that is the one: half a fingertip's width
MOST_REMEMBERED = 4096  # bounds memory; a drive that was forgotten is solved again


class _Drives:
    """Drives as commands for one connected device; silence for a level out of reach with `refuses`.

    `scales` are those of `board_fit`, by actuator.
    """

    def __init__(self, device: Device, capabilities: Capabilities, refuses: bool, scales: Sequence[float]) -> None:
        self._device, self._resolution_hz = device, capabilities.frequency_resolution_hz
        self._refuses, self._scales = refuses, tuple(scales)

    def _encode(self, solved: SteadyDrive | BestRow | None) -> Rendered:
        if solved is None or (self._refuses and not solved.achieved):
            return Rendered(SILENCE, is_achieved=False)
        drive = encode_scaled(clamp(solved, self._device), self._scales, self._resolution_hz)
        return Rendered(DriveCommand(drive, solved.frequency_hz), solved.achieved)


class SteadyDrives(_Drives):
    """The steady drives of one table, solved for positions; with `has_kernels` by compiled kernels, else in NumPy."""

    def __init__(
        self,
        device: Device,
        capabilities: Capabilities,
        modes: Modes,
        refuses: bool,
        scales: Sequence[float],
        *,
        has_kernels: bool = True,
    ) -> None:
        super().__init__(device, capabilities, refuses, scales)
        self._solver = _solver_of(device, modes, has_kernels=has_kernels)
        self._remembered: dict[tuple[Placement, float, float | None, _Known], Rendered] = {}
        self._measured: Sequence[MeasuredFinger] = ()

    def take_fingers(self, measured: Sequence[MeasuredFinger]) -> None:
        """Solve for these fingers as they were measured, where they lie, and for all others as the device has them."""
        self._measured = measured

    def _known_at(self, at_m: complex) -> MeasuredFinger | None:
        near = [each for each in self._measured if abs(each.position_m - at_m) < _SAME_M]
        return min(near, key=lambda each: abs(each.position_m - at_m), default=None)

    def prepare(self) -> None:
        """Load or compile what a solve needs, so that no touch waits for that."""
        self._solver.prepare()

    def rendered(self, placement: Placement, level_db: float, held_hz: float | None = None) -> Rendered:
        """The drive for these fingers at this level; held_hz as for `SteadySolver.solve`."""
        known = tuple(self._known_at(at_m) for at_m in placement.position_m) if self._measured else ()
        key = (placement, level_db, held_hz, known)
        found = self._remembered.get(key)
        if found is None:
            if len(self._remembered) == MOST_REMEMBERED:
                del self._remembered[next(iter(self._remembered))]
            found = self._remembered[key] = self._encode(
                self._solver.solve(placement.position_m, placement.is_felt, level_db, held_hz, known)
            )
        return found


_Known = tuple[MeasuredFinger | None, ...]
"""What was measured of each finger; empty: nothing of any."""


def _solver_of(device: Device, modes: Modes, *, has_kernels: bool) -> "PlainSolver | SteadySolver":
    """The compiled solver, whose Numba takes half a second to load, or the one in NumPy."""
    if not has_kernels:
        from engine.steady.plain_solver import PlainSolver

        return PlainSolver(device, modes)
    from engine.steady.steady_solver import SteadySolver

    return SteadySolver(device, modes)


class ZoneDrives(_Drives):
    """The best rows of a table's sweep, for the zones of the fingers that feel; silence for zones without a row."""

    def __init__(
        self, device: Device, capabilities: Capabilities, rows: BestRows, refuses: bool, scales: Sequence[float]
    ) -> None:
        super().__init__(device, capabilities, refuses, scales)
        self.rows, self._zone_at = rows, ZoneFinder(device).zone_at
        self._remembered: dict[tuple[int, float], Rendered] = {}

    def take_fingers(self, measured: Sequence[MeasuredFinger]) -> None:
        """Nothing: the sweep is that of the surface without fingers."""

    def prepare(self) -> None:
        """Nothing: the table holds all of it."""

    def rendered(self, placement: Placement, level_db: float, held_hz: float | None = None) -> Rendered:  # noqa: ARG002  # zones know no other drive
        """The drive of the zones of the fingers that feel at this level."""
        zones = (self._zone_at(placement.position_m[finger]) for finger in placement.felt)
        return self.of_zones(combination_of(zone for zone in zones if zone is not None), level_db)

    def of_zones(self, combination: int, level_db: float) -> Rendered:
        """The drive of a combination of zones, the sum of 2**zone, at this level."""
        found = self._remembered.get((combination, level_db))
        if found is None:
            found = self._remembered[combination, level_db] = self._encode(self.rows.at(combination, level_db))
        return found
