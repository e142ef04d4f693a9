"""Steady drives made by hand: the frequency says which zones are felt, whether any is quiet, and the level."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from types import SimpleNamespace

from base.points import is_within
from engine.device import Device
from engine.render.board_fit import NO_BASIS
from engine.render.limits import clamp
from engine.render.renderer import SILENCE, DriveCommand, Rendered, RenderedClicks, Renderer
from engine.steady.cases import MeasuredFinger
from engine.touch import Placement, ZoneState
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.drive_words import encode_drive
from firmware_link.protocol.messages import Features
from tests.engine.made_table import LEVEL_DB, made_clicks

FULL_SCALE_M = 0.52e-6
"""Of the actuators of reference-a."""


def plain_board(*full_scales_m: float) -> Capabilities:
    """A board that plays no waveforms; by default of two actuators of reference-a's full scale."""
    full_scales_m = full_scales_m or (FULL_SCALE_M, FULL_SCALE_M)
    return Capabilities(len(full_scales_m), 0.01, 1.0, 655.35, full_scales_m, 100, 48_000, 1, 0)


def board(*full_scales_m: float, **changed: object) -> Capabilities:
    """One that plays waveforms, with other values."""
    room = {"features": Features.WAVEFORMS, "longest_waveform_ms": 100, "basis_capacity_bytes": 1 << 18}
    return replace(plain_board(*full_scales_m), **(room | changed))  # type: ignore[arg-type]  # by name


RESOLUTION_HZ = 0.01


class MadeSteady:
    """Drives of 100 Hz, and 1, 2, 4, 8, 16 Hz for felt zones I to V.

    0.25 Hz more where something is quiet, 0.5 Hz more at another level. `short_of` are zones in which no level is
    reached; `always_hz` is one frequency for all. A finger beside the bar is refused, as the solver does. `solved` has
    every placement that was asked for, with its level.
    """

    def __init__(
        self, device: Device, *, short_of: Collection[int] = (), refuses: bool = False, always_hz: float | None = None
    ) -> None:
        self.device, self.short_of, self.refuses, self.always_hz = device, short_of, refuses, always_hz
        self.solved: list[tuple[Placement, float]] = []
        self.held_hz: list[float | None] = []
        self.prepared = 0
        self.measured: Sequence[MeasuredFinger] = ()

    def take_fingers(self, measured: Sequence[MeasuredFinger]) -> None:
        self.measured = measured

    def prepare(self) -> None:
        self.prepared += 1

    def frequency_hz(self, placement: Placement, level_db: float = LEVEL_DB) -> float:
        if self.always_hz is not None:
            return self.always_hz
        states = placement.zone_states(self.device)
        felt = sum(1 << zone for zone, state in enumerate(states) if state is ZoneState.FELT)
        known = 0.06 * len(self.measured)
        return 100.0 + felt + 0.25 * bool(placement.quiet) + 0.5 * (level_db != LEVEL_DB) + known

    def rendered(self, placement: Placement, level_db: float, held_hz: float | None = None) -> Rendered:
        assert all(is_within(at_m, self.device.surface.corner_m) for at_m in placement.position_m)
        self.solved.append((placement, level_db))
        self.held_hz.append(held_hz)
        states = placement.zone_states(self.device)
        is_achieved = not any(states[zone] is ZoneState.FELT for zone in self.short_of)
        if self.refuses and not is_achieved:
            return Rendered(SILENCE, is_achieved=False)
        actuators = len(self.device.actuators)
        frequency_hz = self.frequency_hz(placement, level_db)
        solved = SimpleNamespace(
            frequencies_hz=(frequency_hz,) * actuators, amplitudes=(1.0,) * actuators, phases_rad=(0.0,) * actuators
        )
        drive = encode_drive(clamp(solved, self.device).channels, RESOLUTION_HZ)
        return Rendered(DriveCommand(drive, frequency_hz), is_achieved)


def made_renderer(device: Device, capabilities: Capabilities, levels_db: Sequence[float] = (LEVEL_DB,)) -> Renderer:
    """A renderer of such drives, without clicks."""
    clicks = RenderedClicks(made_clicks(device, []), NO_BASIS, refuses=False)
    return Renderer(capabilities, MadeSteady(device), clicks, levels_db)
