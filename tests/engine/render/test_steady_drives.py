"""Laws of steady drives as commands: solved for the positions, clamped, encoded and remembered."""

from functools import cache
from math import inf

import numpy as np
import pytest

from engine.render.renderer import SILENCE, DriveCommand
from engine.render.steady_drives import SteadyDrives, ZoneDrives
from engine.steady import Modes
from engine.steady.cases import MeasuredFinger, cases_at, sample_deviations
from engine.steady.steady_solver import SteadySolver
from engine.table.best_rows import BestRows
from engine.touch import Placement
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.drive_words import decode_drive
from precompute.predict.at_positions import SteadyDesigner
from tests.engine.made_states import LEVEL_DB, row_of, rows_of
from tests.engine.render.boards import plain_board
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
CAPABILITIES = plain_board()
PLACEMENT = Placement((0.0371, 0.1234), (True, False))


@cache
def modes() -> Modes:
    return SteadyDesigner(DEVICE).modes


def drives_of(*, refuses: bool = False, capabilities: Capabilities = CAPABILITIES) -> SteadyDrives:
    return SteadyDrives(DEVICE, capabilities, modes(), refuses, (1.0, 1.0))


def test_the_command_is_what_the_solver_finds_to_a_step_of_the_wire() -> None:
    for level_db in (20.0, inf):
        solved = SteadySolver(DEVICE, modes()).solve(PLACEMENT.position_m, PLACEMENT.is_felt, level_db)
        command, is_achieved = drives_of().rendered(PLACEMENT, level_db)
        assert isinstance(command, DriveCommand) and is_achieved == solved.achieved
        for channel, amplitude, phase_rad in zip(
            decode_drive(command.drive, 0.01), solved.amplitudes, solved.phases_rad, strict=True
        ):
            assert channel.frequency_hz == pytest.approx(solved.frequency_hz, abs=0.005)
            assert channel.amplitude == pytest.approx(amplitude, abs=1e-5)
            assert abs((channel.phase_rad - phase_rad + 3) % 6.283185307 - 3) < 1e-4


def test_a_measured_finger_is_solved_for_where_it_lies_and_no_other() -> None:
    drives, device = drives_of(), DEVICE
    before = drives.rendered(PLACEMENT, 20.0)
    drives.take_fingers([MeasuredFinger(PLACEMENT.position_m[1] + 9e-3, 1.0, 0.1)])
    assert drives.rendered(PLACEMENT, 20.0) == before
    known = MeasuredFinger(PLACEMENT.position_m[1] + 2e-3, 1.0, 0.1)
    drives.take_fingers([known])
    solved = SteadySolver(device, modes()).solve(PLACEMENT.position_m, PLACEMENT.is_felt, 20.0, None, [None, known])
    command, _ = drives.rendered(PLACEMENT, 20.0)
    assert isinstance(command, DriveCommand) and command.frequency_hz == solved.frequency_hz
    assert command != before.command
    drives.take_fingers([])
    assert drives.rendered(PLACEMENT, 20.0) == before


def test_the_cases_of_a_measured_finger_are_about_what_was_measured() -> None:
    deviations = sample_deviations(2, 8)
    plain = cases_at(np.array(PLACEMENT.position_m), deviations, DEVICE).impedance
    known = MeasuredFinger(PLACEMENT.position_m[0], 0.5, 0.1)
    found = cases_at(np.array(PLACEMENT.position_m), deviations, DEVICE, [known, None]).impedance
    assert (found[:, 1] == plain[:, 1]).all()
    ratio = np.log(found[:, 0] / plain[0, 0])
    assert ratio[0] == pytest.approx(0.5) and abs(ratio - 0.5).max() == pytest.approx(0.196 * 7 / 8, rel=0.15)
    unsure = cases_at(np.array(PLACEMENT.position_m), deviations, DEVICE, [known._replace(load=0.0, error=9.0), None])
    assert unsure.impedance == pytest.approx(plain), "never wider than the device's own spread"


def test_a_level_out_of_reach_is_silence_where_it_is_refused() -> None:
    command, is_achieved = drives_of(refuses=True).rendered(PLACEMENT, 90.0)
    assert (command, is_achieved) == (SILENCE, False)
    command, is_achieved = drives_of().rendered(PLACEMENT, 90.0)
    assert command != SILENCE and not is_achieved


def zone_drives(*, refuses: bool = False) -> ZoneDrives:
    rows = rows_of(DEVICE, (LEVEL_DB, inf), short_of=(2,))
    return ZoneDrives(DEVICE, CAPABILITIES, rows, refuses, (1.0, 0.5))


def test_zones_play_the_row_of_those_that_feel_scaled_to_the_board() -> None:
    first, second, _, fourth, _ = ((zone.start_m + zone.stop_m) / 2 for zone in DEVICE.zones)
    command, is_achieved = zone_drives().rendered(Placement((first, second, fourth), (True, False, True)), LEVEL_DB)
    row = row_of(DEVICE, (0, 3))
    assert isinstance(command, DriveCommand) and is_achieved and command.frequency_hz is None
    left, right = decode_drive(command.drive, 0.01)
    assert (left.frequency_hz, right.frequency_hz) == pytest.approx(row.frequencies_hz)
    assert (left.amplitude, right.amplitude) == pytest.approx((0.5, 0.125), abs=1e-4)


def test_zones_without_a_row_are_silent_and_so_are_those_out_of_reach_where_they_are_refused() -> None:
    middle_m = DEVICE.bar.length_m / 2
    placement = Placement((middle_m,), (True,))
    assert zone_drives(refuses=True).rendered(placement, LEVEL_DB) == (SILENCE, False)
    command, is_achieved = zone_drives().rendered(placement, LEVEL_DB)
    assert command != SILENCE and not is_achieved
    gap = ZoneDrives(DEVICE, CAPABILITIES, BestRows([], 1.0), refuses=False, scales=(1.0, 1.0))
    assert gap.rendered(placement, LEVEL_DB) == (SILENCE, False)
