"""What the ring tells, what the firmware drives for it and how the bar moves, to pictures."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from base.arrays import FIELD_POINTS
from engine.table import Table
from engine.table.best_rows import BestRows
from engine.touch import Placement
from firmware_link.emulator.drive_log import Cause
from firmware_link.protocol.basis import encode_click
from firmware_link.protocol.drive_words import ChannelDrive
from tactable.page.live_bar import RATE_HZ, LiveBar, PaperBar
from tactable.page.page_messages import LOWEST_DB, Drive, Kind, Role, encode_picture
from tactable.page.processes.live_process import RingDrive
from tactable.page.view import HEARD_S, JUDGED_S, LATENCIES, View
from tactable.rig.promises import Promises, SampledPromises, SolvedClick
from tests.engine.made_table import row_of, rows_of
from tests.tactable.page.played import COUNTERS, FRAME_US, RESOLUTION_HZ, STAGE_NS, record_of

PAIR = Placement((0.035, 0.22), (True, False))
"""Not at places of the table, nor in the middles of zones I and III."""
TURNED = Placement(PAIR.position_m, (False, True))
ONE_ZONE = Placement((0.11, 0.15), (True, False))
"""Both in zone II."""


class Rig:
    """A view whose records are driven as they say."""

    def __init__(self, table: Table, paper: PaperBar | None = None) -> None:
        self.table = table
        self.view = View(table, LiveBar(table.device), RESOLUTION_HZ, paper=paper)
        self._drive = RingDrive(table, RESOLUTION_HZ)
        self.told: list[bytes] = []

    def play(self, seconds: float, *, placement: Placement = PAIR, **words: bool) -> None:
        """Fingers from now on, for so long."""
        self.tell(placement, **words)
        self.go_on(seconds)

    @property
    def next_ns(self) -> int:
        """A moment of the next step; a stamp of 0 is none."""
        return round(1000 * self.view.bar.now_us) + 1000

    def tell(self, placement: Placement, *, is_silent: bool = False, **how: bool) -> None:
        record = record_of(self.table, placement, self.next_ns, level_db=None if is_silent else 20.0, **how)
        self.view.take_events(self._drive.events([record]))
        self.view.read([record])

    def go_on(self, seconds: float) -> None:
        end_us = self.view.bar.now_us + 1e6 * seconds
        while self.view.bar.now_us < end_us:
            self.told += self.view.move(self.view.bar.now_us + FRAME_US, is_loaded=True)


@pytest.fixture
def rig(table: Table) -> Rig:
    return Rig(table)


def test_a_click_is_promised_and_simulated_alike(rig: Rig) -> None:
    rig.play(0.5, is_click=True)
    picture = rig.view.picture()
    assert (picture.command, picture.drive, picture.is_playing) == (1, Drive.CLICK, False)
    assert picture.wanted_db == 20.0
    assert picture.age_s == pytest.approx(0.5, abs=0.03)
    assert [finger.position_m for finger in picture.made] == list(PAIR.position_m)
    for made in picture.made:
        assert made.simulated_db == pytest.approx(made.promised_db, abs=0.25)
    felt, quiet = picture.fingers
    assert felt.felt_db == picture.made[0].simulated_db
    assert (felt.zone, felt.role, quiet.zone, quiet.role) == (0, Role.FELT, 2, Role.QUIET)
    assert [finger.number for finger in picture.made] == [felt.number, quiet.number]
    # What it promises here is not what it promises at its places.
    click = rig.table.click_at(PAIR, 20.0)
    assert click is not None
    at_places, here = [finger.level_db for finger in click.fingers], [made.promised_db for made in picture.made]
    assert at_places != pytest.approx(here, abs=0.3)


@pytest.mark.parametrize("is_click", [True, False])
def test_what_sampled_bars_give_is_told_once_a_command_is_judged(rig: Rig, is_click: bool) -> None:
    rig.view.spreads = SampledPromises(rig.table)
    rig.play(0.9 * JUDGED_S, is_click=is_click)
    assert [(made.low_db, made.high_db) for made in rig.view.picture().made] == [(None, None)] * 2
    rig.go_on(0.2 * JUDGED_S)
    felt, quiet = rig.view.picture().made
    assert felt.low_db is not None and quiet.high_db is not None
    assert felt.promised_db is not None and quiet.promised_db is not None
    assert felt.low_db < felt.promised_db and quiet.promised_db < quiet.high_db


def test_all_is_still_before_the_first_command_of_this_bar_whatever_came_of_a_longer_one_before(rig: Rig) -> None:
    later = record_of(rig.table, PAIR, 1000)
    beyond = Placement((0.035, rig.table.device.bar.length_m + 0.1), (True, False))
    moved = tuple(touch._replace(position_m=at_m) for touch, at_m in zip(later.touches, beyond.position_m, strict=True))
    rig.view.read([later._replace(placement=beyond, touches=moved), later._replace(placement=None, touches=moved)])
    rig.go_on(0.1)
    picture = rig.view.picture()
    assert (picture.command, picture.drive, picture.is_playing, picture.fingers) == (0, Drive.SILENCE, False, ())
    assert picture.levels_db.tolist() == [LOWEST_DB] * FIELD_POINTS
    assert not rig.view.ours.is_moving
    assert encode_picture(picture)[1] == Kind.PICTURE


def test_a_finger_that_came_after_the_command_has_no_role_and_one_that_lifted_no_number(rig: Rig) -> None:
    rig.play(0.2, is_click=True)
    later = record_of(rig.table, PAIR, round(1000 * rig.view.bar.now_us), is_sent=False)
    rig.view.read([later._replace(touches=(later.touches[0]._replace(contact_id=7, position_m=0.1), later.touches[1]))])
    picture = rig.view.picture()
    assert [finger.role for finger in picture.fingers] == [Role.NONE, Role.QUIET]
    assert [finger.number for finger in picture.made] == [None, 2]


def test_a_steady_drive_in_place_of_a_click_does_what_it_promises_and_that_stays_when_it_has_ended(rig: Rig) -> None:
    rig.play(2.0, placement=ONE_ZONE, is_click=True, is_unsolved=True)
    picture = rig.view.picture()
    solved = rig.table.drive_for([ONE_ZONE.position_m[0]], [ONE_ZONE.position_m[1]], 20.0)
    assert (picture.drive, picture.is_playing) == (Drive.STEADY, True)
    assert [(finger.zone, finger.role) for finger in picture.fingers] == [(1, Role.FELT), (1, Role.QUIET)]
    assert [c.frequency_hz for c in picture.channels] == pytest.approx(solved.frequencies_hz, abs=5e-3)
    assert [c.amplitude for c in picture.channels] == pytest.approx(solved.amplitudes, abs=1e-4)
    for made in picture.made:
        assert made.simulated_db == pytest.approx(made.promised_db, abs=0.1)
    _, promise = Promises(rig.table).of_drive(ONE_ZONE, 20.0)
    assert [made.promised_db for made in picture.made] == pytest.approx(promise.level_db, abs=0.1)  # of its modes
    assert picture.fingers[0].level_db == picture.made[0].simulated_db
    rig.play(1.0, placement=ONE_ZONE, is_silent=True)
    after = rig.view.picture()
    assert not after.is_playing
    assert after.made[0].simulated_db == pytest.approx(picture.made[0].simulated_db, abs=0.1)


def test_a_click_that_the_table_does_not_hold_has_the_promise_of_its_waveform_where_it_was_solved(rig: Rig) -> None:
    click = rig.table.click_at(PAIR, 20.0)
    assert click is not None and click.basis is not None
    weights = click.weights.tolist()
    play = encode_click(click.basis, click.basis_set, weights, click.fraction_bits, click.amplitude).play
    solved = SolvedClick.of(play, click.basis, len(rig.table.device.actuators))
    assert solved is not None and np.array_equal(solved.samples, click.samples)
    three = Placement((0.03, 0.1, 0.22), (True, False, False))
    asked = record_of(rig.table, three, 2000, is_click=True)
    rig.view.read([record_of(rig.table, PAIR, 1000, is_click=True), asked])
    picture = rig.view.picture()
    assert (picture.drive, picture.channels) == (Drive.CLICK, ())
    assert [made.promised_db for made in picture.made] == [None, None, None]
    assert rig.view.solved == [] and encode_picture(picture)[1] == Kind.PICTURE
    rig.view.read([asked._replace(play=play)])
    _, promised = Promises(rig.table).of_solved_click(three, solved)
    made = rig.view.picture().made
    assert [each.promised_db for each in made] == pytest.approx(promised.level_db.tolist())
    assert list(rig.view.solved) == [three]


@pytest.mark.parametrize("is_click", [True, False])
def test_the_counted_curve_passes_through_the_levels_of_the_fingers(rig: Rig, is_click: bool) -> None:
    """A browser that gets only the last picture draws a curve that agrees with the printed levels.

    Where a finger is to rest, a steady drive may be stiller than at the points of the curve beside it.
    """
    rig.play(1.0, is_click=is_click)
    picture = rig.view.picture()
    for finger in picture.fingers:
        printed_db = finger.felt_db if is_click else finger.level_db
        drawn_db = np.interp(finger.position_m.real, rig.view.bar.field.position_m.real, picture.counted_db)
        is_null = not is_click and finger.role is Role.QUIET
        assert drawn_db >= printed_db - 1.0 if is_null else drawn_db == pytest.approx(printed_db, abs=1.0)
    if is_click:
        assert picture.levels_db.max() < picture.counted_db.max() - 20  # the click is over


def test_a_stall_over_two_clicks_gives_the_second_no_level_of_the_first_on_both_bars(table: Table) -> None:
    found, papers = [], []
    for step_us in (FRAME_US, 0.9e6):
        rig = Rig(table, PaperBar(LiveBar(table.device), table.best_rows))
        rig.go_on(0.05)
        records = [
            record_of(table, PAIR, rig.next_ns, is_click=True),
            record_of(table, TURNED, rig.next_ns + 400_000_000, is_click=True),
        ]
        rig.view.take_events(rig._drive.events(records))
        rig.view.read(records)
        end_us = rig.view.bar.now_us + 0.8e6
        while rig.view.bar.now_us < end_us:
            rig.view.move(min(rig.view.bar.now_us + step_us, end_us), is_loaded=True)
        picture = rig.view.picture()
        assert picture.paper is not None
        found.append([*(finger.felt_db for finger in picture.fingers), *picture.counted_db])
        papers.append([felt_db for _, felt_db in picture.paper.fingers_db])
    assert found[0] == pytest.approx(found[1], abs=0.05)
    assert papers[0] == pytest.approx(papers[1], abs=0.1) and min(papers[0]) > LOWEST_DB
    assert found[1][1] > found[1][0] + 6  # the second finger felt the second click, the first one rested


def test_what_a_stall_cut_off_and_what_the_firmware_refused_is_not_judged(rig: Rig) -> None:
    rig.play(0.5, is_click=True)
    assert not rig.view.picture().is_late
    rig.tell(TURNED, is_click=True)
    rig.view.move(rig.view.bar.now_us + 2.5e6, is_loaded=True)
    assert rig.view.picture().is_late
    rig.view.read([record_of(rig.table, PAIR, rig.next_ns, is_click=True)._replace(drive_sequence=77)])
    rig.go_on(0.2)
    assert not rig.view.picture().is_late  # its event may still come
    rig.go_on(0.2)
    assert rig.view.picture().is_late


@pytest.mark.parametrize("was_click", [True, False])
def test_a_click_that_cuts_that_of_another_finger_is_no_comparison(rig: Rig, was_click: bool) -> None:
    """Nor one that cuts the steady drive which stands in for a click that is not solved yet."""
    rig.play(0.02, is_click=was_click)
    rig.play(0.3, placement=TURNED, is_click=True)
    assert rig.view.picture().is_mixed
    rig.play(0.3, is_click=True)
    assert not rig.view.picture().is_mixed
    rig.play(0.02, is_click=True)  # the same finger again
    assert not rig.view.picture().is_mixed


def test_latencies_are_those_of_commands_that_a_report_caused(rig: Rig) -> None:
    for _ in range(LATENCIES + 3):
        rig.tell(PAIR, is_click=True)
    rig.tell(PAIR, is_click=True, is_sent=False)
    picture = rig.view.picture()
    assert picture.last_ns == picture.median_ns == (STAGE_NS,) * 5
    assert picture.latencies == LATENCIES
    assert picture.counters == COUNTERS
    assert picture.command == LATENCIES + 3


def test_a_click_can_be_seen_slowed_once_and_heard_by_every_finger(rig: Rig) -> None:
    rig.play(2.0, is_click=True)
    (motion,) = rig.told
    along, rows, fingers, is_click, steps, command, step_s, scale = struct.unpack_from("<4BHIff", motion, 2)
    assert (along, rows, fingers, is_click, command) == (FIELD_POINTS, 1, 2, 1, 1)
    assert steps * step_s == pytest.approx(0.09)
    assert scale > 0
    loudest = []
    for finger in (1, 2):
        sound = rig.view.sound(finger)
        assert sound is not None
        assert struct.unpack_from("<II", sound, 2) == (finger, RATE_HZ)
        samples = np.frombuffer(sound[10:], "<i2")
        assert len(samples) == round(HEARD_S * RATE_HZ)
        loudest.append(abs(samples.astype(np.int32)).max())
    assert loudest[0] > loudest[1]
    assert rig.view.sound(9) is None


def test_a_steady_drive_is_seen_slowed_again_and_again_while_it_plays_then_a_click_as_soon_as_ever(rig: Rig) -> None:
    rig.play(2.0)
    count = len(rig.told)
    assert count >= 2
    rig.play(2.0, is_silent=True)
    assert len(rig.told) <= count + 1
    rig.play(0.5)
    rig.play(0.45, is_click=True)
    assert [command_of(motion) for motion in rig.told[-2:]] == [2, 3]


def test_of_clicks_in_quick_order_some_and_the_last_are_seen(rig: Rig) -> None:
    for _ in range(20):
        rig.play(0.05, is_click=True)
    rig.go_on(1.0)
    assert [command_of(motion) for motion in rig.told] == [1, 9, 17, 20]


@pytest.mark.long
def test_many_touches_leave_nothing_behind(rig: Rig) -> None:
    """Simulated, shown, encoded; a picture alone has a hundred times the bytes that a touch may leave."""
    placement = Placement.named(rig.table.device, ["35 mm"], ["III"])

    def tap(number: int) -> None:
        for is_silent in (False, True):
            rig.tell(placement, is_click=bool(number % 4), is_silent=is_silent)
            for _ in range(2):
                rig.view.move(rig.view.bar.now_us + 250_000, is_loaded=True)
                encode_picture(rig.view.picture())

    for number in range(20):
        tap(number)
    before = resident_bytes()
    for number in range(45):
        tap(number)
    assert rig.view.bar.now_us > 45e6
    assert resident_bytes() < before + (1 << 19)


def resident_bytes() -> int:
    """Memory of this process."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def command_of(motion: bytes) -> int:
    return int(struct.unpack_from("<I", motion, 8)[0])


def played(table: Table, seconds: float, *, is_click: bool, rows: BestRows | None = None) -> View:
    """A view of a command at 50 ms, so many seconds after it; the second bar plays rows, by default the table's."""
    rig = Rig(table, PaperBar(LiveBar(table.device), table.best_rows if rows is None else rows))
    rig.go_on(0.05)
    rig.play(seconds, is_click=is_click)
    return rig.view


def test_the_row_of_the_sweep_comes_to_what_finite_elements_say_with_less_contrast_than_ours(table: Table) -> None:
    picture = played(table, 3.0, is_click=False).picture()
    row, promise = Promises(table).of_row(PAIR, 20.0)
    assert picture.paper is not None and row.zones == (0,)
    assert list(picture.paper.simulated_db) == pytest.approx(promise.level_db, abs=0.5)
    assert [present_db for present_db, _ in picture.paper.fingers_db] == list(picture.paper.simulated_db)
    ours_db = [each.simulated_db or LOWEST_DB for each in picture.made]
    assert ours_db[0] - ours_db[1] > promise.level_db[0] - promise.level_db[1] + 3.5


def test_a_row_of_two_frequencies_moves_the_bar_with_both(table: Table) -> None:
    view = played(table, 2.0, is_click=False, rows=rows_of(table.device))
    row = row_of(table.device, (0,))
    channels = [ChannelDrive(*each) for each in zip(row.frequencies_hz, row.amplitudes, row.phases_rad, strict=True)]
    paper = view.picture().paper
    assert paper is not None
    assert list(paper.simulated_db) == pytest.approx(Promises(table).of_channels(PAIR, channels), abs=0.5)


def test_beside_a_click_the_drive_ends_when_the_click_does(table: Table) -> None:
    view = played(table, 0.5, is_click=True)
    assert view.paper is not None
    bar = view.paper.levels.bar
    during, after = bar.motion(60_000.0, 0.02, 1, ()), bar.motion(450_000.0, 0.02, 1, ())
    assert during is not None and after is not None
    assert abs(during).max() > 10 * abs(after).max() > 0


def test_zones_without_a_row_leave_the_second_bar_at_rest(table: Table) -> None:
    paper = played(table, 0.4, is_click=False, rows=BestRows([], 1.0)).picture().paper
    assert paper is not None and paper.levels_db.max() == LOWEST_DB


@pytest.fixture
def drive(table: Table) -> RingDrive:
    return RingDrive(table, RESOLUTION_HZ)


def test_a_steady_drive_is_that_of_the_positions_from_when_it_was_written(table: Table, drive: RingDrive) -> None:
    record = record_of(table, PAIR, 1_000_000)
    (event,) = drive.events([record])
    solved = table.drive_for([0.035], [0.22], 20.0)
    assert (event.cause, event.device_time_us, event.waveform) == (Cause.SET, 1050, None)
    assert [channel.amplitude for channel in event.channels] == pytest.approx(solved.amplitudes, abs=1e-4)
    assert [channel.frequency_hz for channel in event.channels] == pytest.approx(solved.frequencies_hz, abs=5e-3)


def test_on_a_board_of_another_full_scale_the_bar_moves_as_the_board_does(table: Table) -> None:
    """Commands are fractions of the board's full scale, and the page's bar has the table's."""
    full_scales_m = [2.6e-6 for _ in table.device.actuators]
    plain, scaled = (RingDrive(table, RESOLUTION_HZ, full_m) for full_m in (None, full_scales_m))
    record = record_of(table, PAIR, 1_000_000)
    (own,), (board,) = plain.events([record]), scaled.events([record])
    for channel, moved, actuator in zip(own.channels, board.channels, table.device.actuators, strict=True):
        assert moved.amplitude == pytest.approx(channel.amplitude * 2.6e-6 / actuator.full_scale_m)


def test_a_click_is_the_waveform_of_the_nearest_places_or_of_its_weights(table: Table, drive: RingDrive) -> None:
    three = Placement((0.03, 0.1, 0.2), (True, False, False))
    click, basis = table.click_at(PAIR, 20.0), table.clicks.basis
    assert click is not None and basis is not None
    play = encode_click(basis, click.basis_set, click.weights.tolist(), click.fraction_bits, click.amplitude).play
    tabulated, asked = [record_of(table, placement, 1_000_000, is_click=True) for placement in (PAIR, three)]
    *played, other = drive.events([tabulated, asked._replace(play=play), asked])
    for event in played:
        assert event.waveform is not None and event.cause is Cause.PLAY
        assert np.array_equal(event.waveform.samples, click.samples)
        assert event.waveform.amplitude == pytest.approx(click.amplitude, abs=1e-4)
    assert other.waveform is None
    assert not any(channel.amplitude for channel in other.channels)


def test_what_was_not_sent_drives_nothing(table: Table, drive: RingDrive) -> None:
    assert drive.events([record_of(table, PAIR, 0, is_click=True, is_sent=False)]) == []
    assert drive.events([record_of(table, PAIR, 0, level_db=None, is_sent=False)]) == []


def test_silence_ends_a_drive_even_on_a_lost_port_where_it_has_no_sequence(table: Table, drive: RingDrive) -> None:
    begun, silence = record_of(table, PAIR, 0), record_of(table, PAIR, 9_000_000, level_db=None)
    lost = begun._replace(stamps_ns=(0, 30_000_000, 0, 0, 0, 0), drive_sequence=None, drive=b"")
    for ended, at_us in ((silence, 9050), (lost, 30_000)):
        first, last = drive.events([begun, ended])
        assert any(channel.amplitude for channel in first.channels)
        assert (last.device_time_us, last.waveform) == (at_us, None)
        assert not any(channel.amplitude for channel in last.channels)
