"""The command for fingers, a level and a kind: a click is looked up, a steady drive solved or looked up.

A click of the table becomes the bytes of a PLAY, with its weights of the basis that the device holds; clicks that were
solved since are remembered by their fingers. A steady drive, after `clamp`, becomes the bytes of a SET. Commands are
remembered, so the same fingers cost a dictionary look-up.

Optima are sharp and responses are smooth (docs/theory.md#steady-drives-at-positions), so no drive is tabulated: the
table holds the modes, and a solve takes less time than a report of most digitizers. Until the kernels of the solver are
compiled, once on a machine, a page solves in NumPy (engine.steady.plain_solver). Zones play rows of the table's sweep,
which are looked up (engine.table.best_rows).
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from base.arrays import Mask
from engine.device import Device
from engine.render.board_fit import ChosenBasis
from engine.render.limits import clamp, encode_scaled
from engine.steady import Modes, SteadyDrive
from engine.steady.cases import MeasuredFinger
from engine.table import ClickEntry, Clicks
from engine.table.best_rows import BestRow, BestRows, combination_of
from engine.table.clicks import played_at
from engine.table.levels import LEVEL_TOLERANCE_DB
from engine.touch import Placement
from engine.touch.finger_tracker import ZoneFinder
from firmware_link.host.link import Link
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.basis import EncodedClick, encode_click
from firmware_link.protocol.drive_words import encode_amplitude

if TYPE_CHECKING:
    from engine.steady.plain_solver import PlainSolver
    from engine.steady.steady_solver import SteadySolver


MOST_LEARNED = 256  # of fingers that rest while their effect clicks again
NOT_PLAYED = -1  # stands in place of an amplitude where the device lacks the click's set, or the level is refused
_SAME_M = 8e-3  # a measured finger that is nearer than that is the one: half a fingertip's width
MOST_REMEMBERED = 4096  # bounds memory; a drive that was forgotten is solved again
_Known = tuple[MeasuredFinger | None, ...]
"""What was measured of each finger; empty: nothing of any."""


class DriveCommand(NamedTuple):
    """Hold this drive until the next command; no bytes are silence."""

    drive: bytes
    frequency_hz: float | None = None  # of all actuators; None for silence, and for several frequencies

    def hand_to(self, link: Link) -> None:
        """Send this next, in place of a command that waits."""
        link.set_drive(self.drive)


class PlayCommand(NamedTuple):
    """Play a click once, then silence."""

    click: EncodedClick
    frequency_hz: float | None = None  # always None: a click has no single frequency

    def hand_to(self, link: Link) -> None:
        """Send this next, in place of a command that waits."""
        link.set_play(self.click)


Command = DriveCommand | PlayCommand
SILENCE = DriveCommand(b"")


class Rendered(NamedTuple):
    """A command, and whether it reaches the wanted level with quiet fingers kept quiet."""

    command: Command
    is_achieved: bool


class RenderedClicks:
    """The clicks of one table of which the device holds the basis; silence for what is not achieved with `refuses`."""

    def __init__(self, clicks: Clicks, basis: ChosenBasis, refuses: bool) -> None:
        self.clicks, self.basis = clicks, basis
        self._refuses = refuses
        self._rendered: dict[tuple[int, float], Rendered | None] = {}
        self._learned: dict[Placement, ClickEntry] = {}

    @property
    def number(self) -> int:
        """Number of tabulated clicks that the device can play."""
        return int(np.isin(self.clicks.basis_set, list(self.basis.sets)).sum()) if self.clicks else 0

    @property
    def are_played(self) -> bool:
        """Whether the device plays clicks, and the rules have some."""
        return self.basis.basis is not None

    def is_unknown(self, placement: Placement) -> bool:
        """Whether the device plays clicks, and the click of these fingers is neither in the table nor learned."""
        row = self.clicks.row_of(self.clicks.places.key(placement))
        return self.are_played and row is None and placement not in self._learned

    def learn(self, click: ClickEntry) -> None:
        """Add a click that was solved for fingers; the earliest is forgotten beyond MOST_LEARNED.

        One that was solved in another basis, that of an earlier table, is dropped: its weights mean nothing here.
        """
        if self.clicks.basis is None or click.basis.hash != self.clicks.basis.hash:
            return
        if len(self._learned) == MOST_LEARNED:
            del self._learned[next(iter(self._learned))]
        self._learned[click.placement] = click

    def rendered(self, placement: Placement, level_db: float) -> Rendered | None:
        """The click of the nearest places, else the one solved for just these; None: the device can play neither."""
        if self.basis.basis is None:
            return None
        row = self.clicks.row_of(self.clicks.places.key(placement))
        if row is not None:
            if (row, level_db) not in self._rendered:
                self._rendered[row, level_db] = self._encode(self.clicks[row], level_db)
            return self._rendered[row, level_db]
        learned = self._learned.get(placement)
        return None if learned is None else self._encode(learned, level_db)

    def shortfall(self, level_db: float) -> int:
        """How many clicks of the table do not reach the level with quiet fingers kept quiet."""
        return int((~self._is_achieved(level_db)).sum())

    def amplitude_words(self, level_db: float) -> NDArray[np.int32]:
        """Amplitude (row,) of every click of the table as a PLAY carries it; NOT_PLAYED for one that is not played."""
        clicks = self.clicks
        is_played = np.isin(clicks.basis_set, list(self.basis.sets)) & (clicks.fraction_bits > self.basis.halvings)
        if self._refuses:
            is_played &= self._is_achieved(level_db)
        # Arithmetic of Python, as in `played_at`: powers of NumPy may differ in the last place.
        changes_db = (min(0.0, level_db - low_db) for low_db in clicks.felt_low_db.tolist())
        words = [encode_amplitude(10 ** (change_db / 20)) for change_db in changes_db]
        return np.where(is_played, np.array(words, np.int32), np.int32(NOT_PLAYED))

    def _is_achieved(self, level_db: float) -> Mask:
        low_db = self.clicks.felt_low_db
        return low_db >= level_db - LEVEL_TOLERANCE_DB if np.isfinite(level_db) else np.ones(len(low_db), np.bool_)

    def _encode(self, tabulated: ClickEntry, level_db: float) -> Rendered | None:
        number = self.basis.sets.get(tabulated.basis_set)
        fraction_bits = tabulated.fraction_bits - self.basis.halvings
        if number is None or fraction_bits < 1:
            return None
        click = played_at(tabulated, level_db)
        if self._refuses and not click.achieved:
            return Rendered(SILENCE, is_achieved=False)
        assert self.basis.basis is not None  # it has the click's set
        encoded = encode_click(self.basis.basis, number, click.weights.tolist(), fraction_bits, click.amplitude)
        return Rendered(PlayCommand(encoded), click.achieved)


class Steady(Protocol):
    """Steady drives as commands: `SteadyDrives` solves them for positions, `ZoneDrives` looks them up for zones."""

    def prepare(self) -> None:
        """Load or compile what solving takes."""

    def take_fingers(self, measured: Sequence[MeasuredFinger]) -> None:
        """Know these fingers from now on."""

    def rendered(self, placement: Placement, level_db: float, held_hz: float | None = None) -> Rendered:
        """The drive for these fingers at this level; held_hz: frequency of the drive that they have, and moved."""


class Renderer:
    """Commands of one table on one device, at the rules' levels. `render` raises LimitError for a broken drive."""

    def __init__(
        self, capabilities: Capabilities, steady: Steady, clicks: RenderedClicks, levels_db: Sequence[float]
    ) -> None:
        self.not_achieved = 0  # number of commands that do not reach the level, or do not keep quiet fingers quiet
        self.levels_db = tuple(levels_db)  # levels of the rules
        self.clicks = clicks
        self.steady = steady
        self._wire = _wire_of(capabilities)

    def render(
        self, placement: Placement | None, level_db: float | None, is_click: bool = False, held_hz: float | None = None
    ) -> Command | None:
        """The command for these fingers; SILENCE where none is felt or the level is refused.

        held_hz: frequency of the steady drive that they have, and moved since; None: they have none.

        None: a click is wanted for these fingers that the table does not hold and nobody has solved yet; `fallback` is
        what is played where nobody solves it. A device that plays no clicks gets that at once.
        """
        if placement is None or level_db is None:
            return SILENCE
        if not is_click:
            return self._counted(self.steady.rendered(placement, level_db, held_hz))
        rendered = self.clicks.rendered(placement, level_db)
        if rendered is None:
            return None if self.clicks.is_unknown(placement) else self.fallback(placement, level_db)
        return self._counted(rendered)

    def fallback(self, placement: Placement, level_db: float) -> Command:
        """The steady drive for these fingers, also in place of a click; the effect player ends it."""
        return self._counted(self.steady.rendered(placement, level_db))

    def _counted(self, rendered: Rendered) -> Command:
        self.not_achieved += not rendered.is_achieved
        return rendered.command

    @property
    def click_shortfalls(self) -> dict[float, int]:
        """The number of tabulated clicks that do not reach a level with quiet fingers kept quiet, for each level."""
        if not self.clicks.are_played:
            return {}
        return {level_db: self.clicks.shortfall(level_db) for level_db in self.levels_db}

    def suits_device_of(self, other: "Renderer") -> bool:
        """Whether both were encoded for devices with the same number format on the wire and the same full scales."""
        return self._wire == other._wire

    def fits(self, capabilities: Capabilities) -> bool:
        """Whether a device has the number format and the full scales that the commands are encoded for."""
        return _wire_of(capabilities) == self._wire


def _wire_of(capabilities: Capabilities) -> tuple[float, ...]:
    return (
        capabilities.number_of_actuators,
        capabilities.frequency_resolution_hz,
        capabilities.frequency_minimum_hz,
        capabilities.frequency_maximum_hz,
        capabilities.synthesis_rate_hz,
        *capabilities.full_scales_m,
    )


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
