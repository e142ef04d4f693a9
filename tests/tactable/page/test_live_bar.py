"""A bar and a plate as time goes on: they give what tables promise, however time is cut, and nothing of them grows."""

import json
from dataclasses import replace

import numpy as np
import pytest

from base.arrays import FIELD_POINTS, Field
from base.plain import to_plain
from engine.device import Device
from engine.table import Table
from engine.touch import Placement, Touch
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.synthesis import synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.page.choices import Choice, ChoiceError, changed, moved, offered
from tactable.page.judged_commands import CommandReader
from tactable.page.live_bar import LONGEST_STEP_S, MOST_MOVING, MOST_POINTS, RATE_HZ, LiveBar, decibels
from tactable.page.processes.live_process import RingDrive
from tactable.page.view import device_json
from tactable.rig.promises import OtherBar, SampledPromises
from tactable.shipped import find_device
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


FINGERS_M = (0.05 + 0.04j, 0.15 + 0.1j)
ACTUATOR = """
[[actuator]]
name = "{name}"
position = ["{x} mm", "{y} mm"]
stiffness = "18.9 kN/m"
damping = "0.045 N*s/m"
mass = "9.5 g"
full_scale = "4 um"
band = ["60 Hz", "300 Hz"]
"""
PLATE = f"""
name = "plate"
description = "A small plate of glass on two actuators"
[plate]
length = "200 mm"
width = "120 mm"
thickness = "1.1 mm"
youngs_modulus = "70 GPa"
density = "2500 kg/m^3"
poissons_ratio = "23 %"
mass_damping = "1e-5 1/s"
stiffness_damping = "5e-5 s"
{ACTUATOR.format(name="lower", x=30, y=25)}
{ACTUATOR.format(name="upper", x=165, y=100)}
[zones]
rows = 2
columns = 2
hysteresis = "2 mm"
[finger]
mass = "0.1 g"
damping = "1 N*s/m"
stiffness = "1 kN/m"
spread = 3.0
[sweep]
start = "60 Hz"
stop = "300 Hz"
step = "1 Hz"
amplitude_steps = 5
phase_steps = 36
[limits]
amplitude = "100 %"
ramp = "5 ms"
lease = "40 ms"
"""


def plate() -> Device:
    return Device.parse(PLATE, "plate.toml")


def moving(bar: LiveBar) -> DriveEvent:
    """Half of full scale at 170 Hz on every actuator."""
    device = bar.device
    channels = tuple(ChannelTarget(170.0, 0.5, float(index)) for index, _ in enumerate(device.actuators))
    event = DriveEvent(1000, Cause.SET, None, device.limits.slew_per_s, channels)
    bar.take_events([event])
    return event


@pytest.mark.parametrize("corner_m", [0.3, 0.3 + 0.18j, 0.18 + 0.3j, 0.2 + 0.2j, 0.4 + 0.02j])
def test_a_field_reaches_from_corner_to_corner_with_as_many_points_as_are_sent(corner_m: complex) -> None:
    for most in (MOST_POINTS, MOST_MOVING):
        field = Field.of(corner_m, most)
        assert 2 <= field.along <= FIELD_POINTS and 1 <= field.across <= FIELD_POINTS and field.count <= most
        assert field.position_m[0] == 0 and field.position_m[-1] == pytest.approx(corner_m)
        assert len(field.position_m) == field.count
        assert (field.across == 1) == (corner_m.imag == 0)


def test_fingers_on_a_plate_feel_what_the_whole_plant_does_under_them() -> None:
    """Beside all modes that the band needs, within 0.1 dB."""
    bar = LiveBar(plate())
    event = moving(bar)
    bar.touch([Touch(number, at_m, None) for number, at_m in enumerate(FINGERS_M)], is_loaded=True)
    for stop in range(1, 13):
        bar.move_until(25_000.0 * stop)
    whole = TransientPlant(compute_basis(assemble(bar.device)), np.array(FINGERS_M), RATE_HZ)
    whole.touch([(at_m, bar.device.finger) for at_m in FINGERS_M])
    log = [replace(event, cause=Cause.NEW_SESSION, device_time_us=0, channels=_still(event)), event]
    course = whole.accelerate(synthesise(log, 0.0, 300_000.0, RATE_HZ))
    found = bar.motion(0.0, 0.25, 1, FINGERS_M)
    assert found is not None
    under = found[:, bar.moving.count :]
    assert np.linalg.norm(under - course[: len(under)]) < 0.01 * np.linalg.norm(course)


def _still(event: DriveEvent) -> tuple[ChannelTarget, ...]:
    return tuple(ChannelTarget(0.0, 0.0, None) for _ in event.channels)


def test_the_field_of_a_plate_has_the_levels_of_its_fingers() -> None:
    """A finger that loads nothing, at a point of the field; every fourth sample misses less than 0.5 dB of a peak."""
    bar = LiveBar(plate())
    moving(bar)
    point = bar.field.count // 3
    bar.touch([Touch(1, complex(bar.field.position_m[point]), None)], is_loaded=False)
    found = [bar.move_until(25_000.0 * stop) for stop in range(1, 13)][-1]
    assert found is not None
    assert found.peak.field_db[point] == pytest.approx(found.peak.finger_db[1], abs=0.5)
    assert found.power.field_db[point] == pytest.approx(found.power.finger_db[1], abs=1e-6)
    assert found.peak.finger_db[1] > decibels(np.array([1.0]))[0]


def test_the_points_of_a_plate_are_pairs_in_what_a_page_is_told() -> None:
    device = plate()
    told = json.loads(json.dumps(device_json(device)))
    assert told["corner_m"] == to_plain(device.surface.corner_m)
    for name, part in (("actuators", "position_m"), ("zones", "start_m"), ("zones", "stop_m")):
        assert [each[part] for each in told[name]] == [to_plain(getattr(each, part)) for each in getattr(device, name)]


def test_actuators_of_a_plate_move_in_both_directions() -> None:
    device, offers = plate(), offered("plate.toml")
    places = [[0.04, 0.05], [0.15, 0.03]]
    choice = changed(Choice("plate.toml"), {"actuators_m": places}, device, offers)
    assert to_plain(choice)["actuators_m"] == places
    assert np.allclose([to_plain(each.position_m) for each in moved(device, choice).actuators], places)
    for other, surface in (([0.04, 0.15], device), (places, find_device("reference-a"))):
        with pytest.raises(ChoiceError, match="actuators_m"):
            changed(Choice("plate.toml"), {"actuators_m": other}, surface, offers)
