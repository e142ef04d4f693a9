"""What the ring tells and how the bar moves, to pictures."""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from engine.table import Table
from engine.touch import ZoneState, state_index
from tactable.page.live_bar import POINTS, RATE_HZ, LiveBar
from tactable.page.messages import LOWEST_DB, Drive, Kind, encode_picture
from tactable.page.ring_drive import RingDrive
from tactable.page.view import HEARD_S, LATENCIES, View
from tests.tactable.page.played import COUNTERS, FRAME_US, RESOLUTION_HZ, STAGE_NS, record_of

FREE, QUIET, FELT = ZoneState.FREE, ZoneState.QUIET, ZoneState.FELT
PAIR = (FELT, FREE, QUIET)


@pytest.fixture(scope="module")
def table(click_table: Path) -> Iterator[Table]:
    with Table.open(click_table) as opened:
        yield opened


class Rig:
    """A view whose records are driven as they say."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self.view = View(table, LiveBar(table.device), RESOLUTION_HZ)
        self._drive = RingDrive(table, RESOLUTION_HZ)
        self.told: list[bytes] = []

    def play(self, seconds: float, *, states: tuple[ZoneState, ...] = PAIR, **words: bool) -> None:
        """A state from now on, for so long."""
        self.tell(states, **words)
        self.go_on(seconds)

    def tell(
        self, states: tuple[ZoneState, ...], *, is_click: bool = False, is_silent: bool = False, is_sent: bool = True
    ) -> None:
        level_db = None if is_silent else 20.0
        at_ns = round(1000 * self.view.bar.now_us) + 1000  # a stamp of 0 is none
        record = record_of(self.table, states, at_ns, is_click=is_click, level_db=level_db, is_sent=is_sent)
        self.view.bar.take(self._drive.events([record]))
        self.view.read([record])

    def go_on(self, seconds: float) -> None:
        end_us = self.view.bar.now_us + 1e6 * seconds
        while self.view.bar.now_us < end_us:
            self.told += self.view.move(self.view.bar.now_us + FRAME_US, is_loaded=True)


@pytest.fixture
def rig(table: Table) -> Rig:
    return Rig(table)


def test_before_the_first_command_all_is_still(rig: Rig) -> None:
    rig.go_on(0.1)
    picture = rig.view.picture()
    assert (picture.command, picture.drive, picture.is_playing, picture.fingers) == (0, Drive.SILENCE, False, ())
    assert picture.levels_db.tolist() == [LOWEST_DB] * POINTS
    assert not rig.view.is_moving
    assert encode_picture(picture)[1] == Kind.PICTURE


def test_a_click_is_promised_and_simulated_alike(rig: Rig) -> None:
    rig.play(0.5, is_click=True)
    picture = rig.view.picture()
    assert (picture.command, picture.drive, picture.is_playing) == (1, Drive.CLICK, False)
    assert picture.state == state_index(PAIR)
    assert picture.wanted_db == 20.0
    assert picture.age_s == pytest.approx(0.5, abs=0.03)
    assert [zone.promised_db is None for zone in picture.zones] == [False, True, False]
    for zone in (picture.zones[0], picture.zones[2]):
        assert zone.simulated_db == pytest.approx(zone.promised_db, abs=0.25)
    felt, quiet = picture.fingers
    assert felt.felt_db == picture.zones[0].simulated_db
    assert (felt.zone, felt.state, quiet.zone, quiet.state) == (0, FELT, 2, QUIET)


def test_a_steady_drive_is_promised_and_simulated_alike_and_says_its_channels(rig: Rig) -> None:
    rig.play(2.0)
    picture = rig.view.picture()
    entry = rig.table.entry_at(state_index(PAIR), 20.0)
    assert entry is not None
    assert (picture.drive, picture.is_playing) == (Drive.STEADY, True)
    assert [c.frequency_hz for c in picture.channels] == pytest.approx(entry.frequencies_hz, abs=5e-3)
    assert [c.amplitude for c in picture.channels] == pytest.approx(entry.amplitudes, abs=1e-4)
    for zone in (picture.zones[0], picture.zones[2]):
        assert zone.simulated_db == pytest.approx(zone.promised_db, abs=0.1)
    assert picture.fingers[0].level_db == picture.zones[0].simulated_db


def test_what_a_steady_drive_came_to_stays_when_it_has_ended(rig: Rig) -> None:
    rig.play(1.0)
    before = rig.view.picture().zones[0].simulated_db
    rig.play(1.0, is_silent=True)
    after = rig.view.picture()
    assert not after.is_playing
    assert after.zones[0].simulated_db == pytest.approx(before, abs=0.1)


@pytest.mark.parametrize("is_click", [True, False])
def test_the_counted_curve_passes_through_the_levels_of_the_fingers(rig: Rig, is_click: bool) -> None:
    """A browser that gets only the last picture draws a curve that agrees with the printed levels."""
    rig.play(1.0, is_click=is_click)
    picture = rig.view.picture()
    for finger in picture.fingers:
        printed_db = finger.felt_db if is_click else finger.level_db
        drawn_db = np.interp(finger.position_m, rig.view.bar.grid_m, picture.counted_db)
        assert drawn_db == pytest.approx(printed_db, abs=1.0)
    if is_click:
        assert picture.levels_db.max() < picture.counted_db.max() - 20  # the click is over


def test_a_stall_over_two_clicks_gives_the_second_no_level_of_the_first(table: Table) -> None:
    found = []
    for step_us in (FRAME_US, 0.9e6):
        rig = Rig(table)
        rig.go_on(0.05)
        first_ns = round(1000 * rig.view.bar.now_us) + 1000
        records = [
            record_of(table, PAIR, first_ns, is_click=True),
            record_of(table, (QUIET, FREE, FELT), first_ns + 400_000_000, is_click=True),
        ]
        rig.view.bar.take(rig._drive.events(records))
        rig.view.read(records)
        end_us = rig.view.bar.now_us + 0.8e6
        while rig.view.bar.now_us < end_us:
            rig.view.move(min(rig.view.bar.now_us + step_us, end_us), is_loaded=True)
        picture = rig.view.picture()
        found.append([*(finger.felt_db for finger in picture.fingers), *picture.counted_db])
    assert found[0] == pytest.approx(found[1], abs=0.05)
    assert found[1][1] > found[1][0] + 10  # the second finger felt the second click, the first one rested


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
    points, is_click, steps, command, step_s, scale = struct.unpack_from("<BBHIff", motion, 2)
    assert (points, is_click, command) == (POINTS, 1, 1)
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


def test_a_steady_drive_is_seen_slowed_again_and_again_while_it_plays(rig: Rig) -> None:
    rig.play(2.0)
    count = len(rig.told)
    assert count >= 2
    rig.play(2.0, is_silent=True)
    assert len(rig.told) <= count + 1


def test_clicks_in_quick_order_are_still_seen(rig: Rig) -> None:
    for _ in range(20):
        rig.play(0.05, is_click=True)
    assert rig.told
