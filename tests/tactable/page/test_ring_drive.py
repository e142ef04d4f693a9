"""Records of a ring to what the firmware drives."""

import numpy as np
import pytest

from engine.table import Table
from engine.touch import Placement
from firmware_link.emulator.drive_log import Cause
from firmware_link.protocol.basis import encode_click
from tactable.page.processes.live_process import RingDrive
from tests.tactable.page.played import RESOLUTION_HZ, record_of

FINGERS = Placement((0.035, 0.22), (True, False))


@pytest.fixture
def drive(table: Table) -> RingDrive:
    return RingDrive(table, RESOLUTION_HZ)


def test_a_steady_drive_is_that_of_the_positions_from_when_it_was_written(table: Table, drive: RingDrive) -> None:
    record = record_of(table, FINGERS, 1_000_000)
    (event,) = drive.events([record])
    solved = table.drive_for([0.035], [0.22], 20.0)
    assert (event.cause, event.device_time_us, event.waveform) == (Cause.SET, 1050, None)
    assert [channel.amplitude for channel in event.channels] == pytest.approx(solved.amplitudes, abs=1e-4)
    assert [channel.frequency_hz for channel in event.channels] == pytest.approx(solved.frequencies_hz, abs=5e-3)


def test_on_a_board_of_another_full_scale_the_bar_moves_as_the_board_does(table: Table) -> None:
    """Commands are fractions of the board's full scale, and the page's bar has the table's."""
    full_scales_m = [2.6e-6 for _ in table.device.actuators]
    plain, scaled = (RingDrive(table, RESOLUTION_HZ, full_m) for full_m in (None, full_scales_m))
    record = record_of(table, FINGERS, 1_000_000)
    (own,), (board,) = plain.events([record]), scaled.events([record])
    for channel, moved, actuator in zip(own.channels, board.channels, table.device.actuators, strict=True):
        assert moved.amplitude == pytest.approx(channel.amplitude * 2.6e-6 / actuator.full_scale_m)


def test_a_click_is_the_waveform_of_the_nearest_places_or_of_its_weights(table: Table, drive: RingDrive) -> None:
    three = Placement((0.03, 0.1, 0.2), (True, False, False))
    click, basis = table.click_at(FINGERS, 20.0), table.clicks.basis
    assert click is not None and basis is not None
    play = encode_click(basis, click.basis_set, click.weights.tolist(), click.fraction_bits, click.amplitude).play
    tabulated, asked = [record_of(table, placement, 1_000_000, is_click=True) for placement in (FINGERS, three)]
    *played, other = drive.events([tabulated, asked._replace(play=play), asked])
    for event in played:
        assert event.waveform is not None and event.cause is Cause.PLAY
        assert np.array_equal(event.waveform.samples, click.samples)
        assert event.waveform.amplitude == pytest.approx(click.amplitude, abs=1e-4)
    assert other.waveform is None
    assert not any(channel.amplitude for channel in other.channels)


def test_what_was_not_sent_drives_nothing(table: Table, drive: RingDrive) -> None:
    assert drive.events([record_of(table, FINGERS, 0, is_click=True, is_sent=False)]) == []
    assert drive.events([record_of(table, FINGERS, 0, level_db=None, is_sent=False)]) == []


def test_silence_ends_a_drive_even_on_a_lost_port_where_it_has_no_sequence(table: Table, drive: RingDrive) -> None:
    begun, silence = record_of(table, FINGERS, 0), record_of(table, FINGERS, 9_000_000, level_db=None)
    lost = begun._replace(stamps_ns=(0, 30_000_000, 0, 0, 0, 0), drive_sequence=None, drive=b"")
    for ended, at_us in ((silence, 9050), (lost, 30_000)):
        first, last = drive.events([begun, ended])
        assert any(channel.amplitude for channel in first.channels)
        assert (last.device_time_us, last.waveform) == (at_us, None)
        assert not any(channel.amplitude for channel in last.channels)
