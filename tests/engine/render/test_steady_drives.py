"""Laws of steady drives as commands: solved for the positions, clamped, encoded and remembered."""

from functools import cache
from math import inf
from pathlib import Path

import pytest

from engine.render import SILENCE, DriveCommand
from engine.render.steady_drives import SteadyDrives, ZoneDrives
from engine.steady import Receptances
from engine.steady.solver import SteadySolver
from engine.table import Table
from engine.touch import Placement
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import decode_drive
from precompute.entries.at_positions import SteadyDesigner
from tests.engine.made_entries import entry_of
from tests.engine.made_table import write_table
from tests.engine.render.boards import plain_board
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
CAPABILITIES = plain_board()
PLACEMENT = Placement((0.0371, 0.1234), (True, False))


@cache
def receptances() -> Receptances:
    return SteadyDesigner(DEVICE).receptances


def drives_of(*, refuses: bool = False, capabilities: Capabilities = CAPABILITIES) -> SteadyDrives:
    return SteadyDrives(DEVICE, capabilities, receptances(), refuses, (1.0, 1.0))


def test_the_command_is_what_the_solver_finds_to_a_step_of_the_wire() -> None:
    for level_db in (20.0, inf):
        solved = SteadySolver(DEVICE, receptances()).solve(PLACEMENT.position_m, PLACEMENT.is_felt, level_db)
        command, is_achieved = drives_of().rendered(PLACEMENT, level_db)
        assert isinstance(command, DriveCommand) and is_achieved == solved.achieved
        for channel, amplitude, phase_rad in zip(
            decode_drive(command.drive, 0.01), solved.amplitudes, solved.phases_rad, strict=True
        ):
            assert channel.frequency_hz == pytest.approx(solved.frequency_hz, abs=0.005)
            assert channel.amplitude == pytest.approx(amplitude, abs=1e-5)
            assert abs((channel.phase_rad - phase_rad + 3) % 6.283185307 - 3) < 1e-4


def test_the_same_fingers_are_solved_once() -> None:
    drives = drives_of()
    assert drives.rendered(PLACEMENT, 20.0) is drives.rendered(PLACEMENT, 20.0)
    assert drives.rendered(PLACEMENT, 20.0) != drives.rendered(PLACEMENT, 10.0)


def test_a_level_out_of_reach_is_silence_where_it_is_refused() -> None:
    command, is_achieved = drives_of(refuses=True).rendered(PLACEMENT, 90.0)
    assert (command, is_achieved) == (SILENCE, False)
    command, is_achieved = drives_of().rendered(PLACEMENT, 90.0)
    assert command != SILENCE and not is_achieved


def test_without_kernels_the_drive_of_the_fingers_zones_is_played(tmp_path: Path) -> None:
    first, _, _, fourth, _ = ((zone.start_m + zone.stop_m) / 2 for zone in DEVICE.zones)
    placement = Placement((first, fourth), (True, False))
    entry = entry_of(DEVICE, placement.zone_states(DEVICE))
    with Table.open(write_table(tmp_path / "bar.nc", DEVICE, [entry])) as table:
        drives = ZoneDrives(table, CAPABILITIES, refuses=True, scales=(1.0, 1.0))
        command, is_achieved = drives.rendered(placement, entry.wanted_level_db)
        assert isinstance(command, DriveCommand) and is_achieved == entry.achieved
        for channel, amplitude in zip(decode_drive(command.drive, 0.01), entry.amplitudes, strict=True):
            assert channel.amplitude == pytest.approx(amplitude, abs=1e-5)
        assert drives.rendered(Placement((first,), (True,)), 20.0) == (SILENCE, False)
