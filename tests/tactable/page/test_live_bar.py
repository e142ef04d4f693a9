"""The bar as time goes on: it gives what the table promises, however time is cut, and nothing of it grows."""

import numpy as np
import pytest

from base.arrays import FIELD_POINTS
from engine.table import Table
from engine.touch import Placement, Touch
from firmware_link.emulator.synthesis import synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.page.judged_commands import CommandReader
from tactable.page.live_bar import LONGEST_STEP_S, RATE_HZ, LiveBar, decibels
from tactable.page.processes.live_process import RingDrive
from tactable.rig.promises import OtherBar, SampledPromises
from tests.quick import first_quick
from tests.tactable.page.played import FRAME_US, RESOLUTION_HZ, bar_of, events_of, record_of, touches_of

PAIR = Placement((0.035, 0.22), (True, False))
ALONE = Placement((0.05,), (True,))
START_NS = 1_000_000


def touched(table: Table, placement: Placement, *, is_click: bool = False) -> LiveBar:
    """A bar with these fingers on it, which is driven for them from START_NS on."""
    bar = bar_of(table, [record_of(table, placement, START_NS, is_click=is_click)])
    fingers = list(touches_of(table, placement))
    bar.touch(fingers, is_loaded=True)
    return bar


def run(bar: LiveBar, seconds: float, step_us: float = FRAME_US) -> None:
    while bar.now_us < 1e6 * seconds:
        bar.move_until(bar.now_us + step_us)


@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_however_time_is_cut_the_motion_is_that_of_the_whole_plant(table: Table, seed: int) -> None:
    """All modes at twice the rate, and the finger on it, in one stretch."""
    bar = touched(table, PAIR)
    for step_us in np.random.default_rng(seed).uniform(200.0, 150_000.0, 8).tolist():
        bar.move_until(bar.now_us + step_us)
    plant = TransientPlant(compute_basis(assemble(table.device)), bar.field.position_m, 2 * RATE_HZ)
    plant.touch([(touch.position_m, table.device.finger) for touch in touches_of(table, PAIR)])
    events = events_of(table, [record_of(table, PAIR, START_NS)])
    whole = plant.run(synthesise(events, 0.0, bar.now_us, 2 * RATE_HZ))[0][::2]
    motion = bar.motion(0.0, 0.15, 1, ())
    assert motion is not None
    assert np.linalg.norm(motion - whole[: len(motion)]) < 0.01 * np.linalg.norm(motion)


def test_fingers_that_load_nothing_feel_the_bar_as_it_moves_without_them(table: Table) -> None:
    bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    point = FIELD_POINTS // 3
    bar.touch([Touch(1, float(bar.field.position_m[point]), None)], is_loaded=False)
    untouched = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    for stop in range(1, 12):
        moved, alone = bar.move_until(stop * FRAME_US), untouched.move_until(stop * FRAME_US)
        assert (moved is None) == (alone is None)
        if moved is not None and alone is not None:
            assert moved.peak.finger_db[1] == pytest.approx(moved.peak.field_db[point], abs=1e-6)
            assert moved.peak.field_db == pytest.approx(alone.peak.field_db, abs=1e-6)


def test_a_bar_that_nothing_drives_is_at_rest_and_a_click_rings_down_to_it(table: Table) -> None:
    bar = bar_of(table, [])
    bar.touch([Touch(1, 0.035, None)], is_loaded=True)
    assert [bar.move_until(stop * FRAME_US) for stop in range(1, 20)] == [None] * 19
    bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    run(bar, 8.0, 1e6 * LONGEST_STEP_S / 4)
    assert bar.move_until(bar.now_us + FRAME_US) is None


@pytest.mark.parametrize("seconds", first_quick([0.3, 0.99, 1.0, 1.01, 60.0, 0.7, 1.3, 1.7, 2.0, 2.5], 5))
def test_a_step_of_any_length_goes_to_its_end_and_a_stall_in_it_hurts_no_level(table: Table, seconds: float) -> None:
    bar = touched(table, ALONE)
    run(bar, 0.3)
    end_us = bar.now_us + 1e6 * seconds
    moved = bar.move_until(end_us)
    assert bar.now_us == end_us and moved is not None and moved.peak.finger_db.keys() == {1}
    assert moved.power.finger_db[1] == pytest.approx(20.0, abs=0.2)


def test_what_is_remembered_of_commands_does_not_grow(table: Table) -> None:
    bar, lengths = bar_of(table, []), []
    drive = RingDrive(table, RESOLUTION_HZ)
    for second in range(24):
        begun = record_of(table, PAIR, second * 10**9, is_click=second % 3 == 0)
        silence = record_of(table, PAIR, second * 10**9 + 300_000_000, level_db=None)
        bar.take_events(drive.events([begun, silence]))
        run(bar, second + 1.0, 1e5)
        lengths.append(bar._synthesis.size)
    assert max(lengths[12:]) <= max(lengths[:12]) <= 16


def test_a_finger_that_left_can_be_heard_until_its_place_is_needed(table: Table) -> None:
    bar = touched(table, ALONE, is_click=True)
    run(bar, 0.2)
    bar.touch([], is_loaded=True)
    heard = bar.felt(1)
    assert heard is not None
    assert decibels(abs(heard).max(keepdims=True))[0] > 10
    for number in range(2, 18):
        bar.touch([Touch(number, 0.1, None)], is_loaded=True)
    assert bar.felt(1) is None
    other = bar.felt(17)
    assert other is not None
    assert not other.any()


def test_a_moment_is_seen_only_once_it_is_over_and_while_it_is_kept(table: Table) -> None:
    bar = bar_of(table, [record_of(table, PAIR, START_NS, is_click=True)])
    run(bar, 0.1)
    assert bar.motion(1000.0, 0.2, 4, ()) is None
    found = bar.motion(1000.0, 0.09, 4, PAIR.position_m)
    assert found is not None
    assert found.shape == (270, FIELD_POINTS + 2)
    run(bar, 2.0)
    assert bar.motion(1000.0, 0.09, 4, PAIR.position_m) is None


@pytest.mark.parametrize("is_click", [True, False])
def test_other_bars_of_the_spread_keep_what_is_promised_in_19_of_20(table: Table, is_click: bool) -> None:
    """With other fingers, beside where they seem to be; of 40 bars two are to be expected to break it."""
    record = record_of(table, PAIR, START_NS, is_click=is_click)
    command = CommandReader(table, RESOLUTION_HZ).command_of(record, 0)
    assert command is not None and command.played is not None
    (least_db, _), (_, most_db) = SampledPromises(table).of(PAIR, command.played).T
    levels_db = [levels_on(table, OtherBar(table.device, seed), is_click=is_click) for seed in range(40)]
    felt_db, quiet_db = np.array(levels_db).T
    assert min((felt_db >= least_db).sum(), (quiet_db <= most_db).sum()) >= 36
    assert np.ptp(felt_db) > 0.3 and np.ptp(quiet_db) > 1.0


def levels_on(table: Table, other: OtherBar, *, is_click: bool) -> list[float]:
    """The levels of the fingers of PAIR on another bar."""
    bar = touched(table, PAIR, is_click=is_click)
    bar.become(other)
    if is_click:
        run(bar, 0.1)
        found = bar.greatest_since(0.0).finger_db
    else:
        run(bar, 0.8, 1e5)
        moved = bar.move_until(bar.now_us + FRAME_US)
        assert moved is not None
        found = moved.power.finger_db
    return [found[touch.contact_id] for touch in touches_of(table, PAIR)]
