"""The bar as time goes on: it gives what the table promises, however time is cut, and nothing of it grows."""

import numpy as np
import pytest

from engine.table import Table
from engine.touch import Placement
from firmware_link.emulator import synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.page.live_bar import LONGEST_STEP_S, POINTS, RATE_HZ, BarFinger, LiveBar, decibels
from tactable.page.messages import LOWEST_DB
from tactable.page.ring_drive import RingDrive
from tactable.rig.promises import Promises
from tests.quick import first_quick
from tests.tactable.page.played import FRAME_US, RESOLUTION_HZ, bar_of, events_of, record_of, touches_of

PAIR = Placement((0.035, 0.22), (True, False))
ALONE = Placement((0.05,), (True,))
ONE_ZONE = Placement((0.11, 0.15), (False, True))
"""Both in zone II."""
START_NS = 1_000_000


def fingers_of(table: Table, placement: Placement) -> list[BarFinger]:
    return [BarFinger(touch.contact_id, touch.position_m) for touch in touches_of(table, placement)]


def run(bar: LiveBar, seconds: float, step_us: float = FRAME_US) -> tuple[dict[int, float], dict[int, float]]:
    """Greatest level under each finger, and its level at the end."""
    greatest, last = dict[int, float](), dict[int, float]()
    while bar.now_us < 1e6 * seconds:
        moved = bar.move_until(bar.now_us + step_us)
        if moved is not None:
            last = dict(moved.power_db)
            greatest = {number: max(level, greatest.get(number, LOWEST_DB)) for number, level in moved.peak_db.items()}
    return greatest, last


@pytest.mark.parametrize("placement", [ALONE, PAIR, ONE_ZONE])
def test_a_click_and_a_steady_drive_do_at_their_positions_what_was_promised(table: Table, placement: Placement) -> None:
    promises, found = Promises(table), list[list[float]]()
    for is_click, seconds in ((True, 0.3), (False, 2.0)):
        bar = bar_of(table, [record_of(table, placement, START_NS, is_click=is_click)])
        bar.touch(fingers_of(table, placement), is_loaded=True)
        greatest, last = run(bar, seconds)
        found.append([*(greatest if is_click else last).values()])
    click, (_, promise) = promises.of_tabulated_click(placement, 20.0), promises.of_drive(placement, 20.0)
    assert click is not None
    assert found[0] == pytest.approx(click[1].level_db.tolist(), abs=0.25)
    # Far below what is felt, the steps of the wire are heard.
    assert np.maximum(found[1], -20.0) == pytest.approx(np.maximum(promise.level_db, -20.0), abs=0.1)


def test_the_motion_is_that_of_the_whole_plant(table: Table) -> None:
    """All modes at twice the rate, and the finger on it, in one stretch."""
    records = [record_of(table, PAIR, START_NS)]
    bar = bar_of(table, records)
    bar.touch(fingers_of(table, PAIR), is_loaded=True)
    run(bar, 0.2)
    plant = TransientPlant(compute_basis(assemble(table.device)), bar.grid_m, 2 * RATE_HZ)
    plant.touch([(touch.position_m, table.device.finger) for touch in touches_of(table, PAIR)])
    events = events_of(table, records)
    whole = plant.run(synthesise(events, 0.0, bar.now_us, 2 * RATE_HZ))[0][::2]
    motion = bar.motion(0.0, 0.15, 1)
    assert motion is not None
    assert np.linalg.norm(motion - whole[: len(motion)]) < 0.01 * np.linalg.norm(motion)


@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_however_time_is_cut_the_motion_is_the_same(table: Table, seed: int) -> None:
    steps_us = np.random.default_rng(seed).uniform(200.0, 150_000.0, 8)
    motions = []
    for cuts_us in (np.cumsum(steps_us), np.arange(FRAME_US, steps_us.sum(), FRAME_US)):
        bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
        bar.touch(fingers_of(table, PAIR), is_loaded=True)
        for stop_us in [*cuts_us.tolist(), float(steps_us.sum())]:
            bar.move_until(stop_us)
        motion = bar.motion(0.0, 0.15, 1)
        assert motion is not None
        motions.append(motion)
    assert abs(motions[0]).max() > 0.1
    assert motions[0] == pytest.approx(motions[1], abs=1e-6)


def test_fingers_that_load_nothing_feel_the_bar_as_it_moves_without_them(table: Table) -> None:
    bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    point = POINTS // 3
    bar.touch([BarFinger(1, float(bar.grid_m[point]))], is_loaded=False)
    untouched = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    for stop in range(1, 12):
        moved, alone = bar.move_until(stop * FRAME_US), untouched.move_until(stop * FRAME_US)
        assert (moved is None) == (alone is None)
        if moved is not None and alone is not None:
            assert moved.peak_db[1] == pytest.approx(moved.levels_db[point], abs=1e-6)
            assert moved.levels_db == pytest.approx(alone.levels_db, abs=1e-6)


def test_a_bar_that_nothing_drives_is_at_rest_and_a_click_rings_down_to_it(table: Table) -> None:
    bar = bar_of(table, [])
    bar.touch(fingers_of(table, PAIR), is_loaded=True)
    assert [bar.move_until(stop * FRAME_US) for stop in range(1, 20)] == [None] * 19
    bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    run(bar, 8.0, 1e6 * LONGEST_STEP_S / 4)
    assert bar.move_until(bar.now_us + FRAME_US) is None


@pytest.mark.parametrize("seconds", first_quick([0.3, 0.99, 1.0, 1.01, 10.0, 0.7, 1.3, 1.7, 2.0, 2.5], 5))
def test_a_step_of_any_length_gives_every_finger_a_level(table: Table, seconds: float) -> None:
    bar = bar_of(table, [record_of(table, ALONE, START_NS)])
    bar.touch(fingers_of(table, ALONE), is_loaded=True)
    bar.move_until(FRAME_US)
    moved = bar.move_until(bar.now_us + 1e6 * seconds)
    assert moved is not None and len(moved.peak_db) == 1


def test_a_stall_leaves_out_what_was_missed_and_hurts_no_level(table: Table) -> None:
    record = record_of(table, ALONE, START_NS)
    bar = bar_of(table, [record])
    bar.touch(fingers_of(table, ALONE), is_loaded=True)
    run(bar, 0.3)
    moved = bar.move_until(60e6)
    assert bar.now_us == 60e6
    assert moved is not None
    assert moved.power_db[1] == pytest.approx(20.0, abs=0.2)


def test_what_is_remembered_of_commands_does_not_grow(table: Table) -> None:
    bar, lengths = bar_of(table, []), []
    drive = RingDrive(table, RESOLUTION_HZ)
    for second in range(24):
        at_ns = second * 1_000_000_000
        placement = PAIR if second % 2 else ALONE
        records = [
            record_of(table, placement, at_ns, is_click=second % 3 == 0),
            record_of(table, placement, at_ns + 300_000_000, level_db=None),
        ]
        bar.take_events(drive.events(records))
        for tenth in range(1, 11):
            bar.move_until(1e6 * (second + tenth / 10))
        lengths.append(bar._synthesis.size)
    assert max(lengths[12:]) <= max(lengths[:12]) <= 16


def test_a_finger_that_left_can_be_heard_until_its_place_is_needed(table: Table) -> None:
    bar = bar_of(table, [record_of(table, ALONE, START_NS, is_click=True)])
    bar.touch(fingers_of(table, ALONE), is_loaded=True)
    run(bar, 0.2)
    bar.touch([], is_loaded=True)
    heard = bar.felt(1)
    assert heard is not None
    assert decibels(abs(heard).max(keepdims=True))[0] > 10
    for number in range(2, 18):
        bar.touch([BarFinger(number, 0.1)], is_loaded=True)
    assert bar.felt(1) is None
    other = bar.felt(17)
    assert other is not None
    assert not other.any()


def test_a_moment_is_seen_only_once_it_is_over_and_while_it_is_kept(table: Table) -> None:
    bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    run(bar, 0.1)
    assert bar.motion(1000.0, 0.2, 4) is None
    found = bar.motion(1000.0, 0.09, 4)
    assert found is not None
    assert found.shape == (270, POINTS)
    run(bar, 2.0)
    assert bar.motion(1000.0, 0.09, 4) is None
