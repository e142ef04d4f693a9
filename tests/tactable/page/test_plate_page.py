"""A plate on the page: its field, its fingers and its actuators are points."""

import json
from dataclasses import replace

import numpy as np
import pytest

from base.arrays import FIELD_POINTS, Field
from base.plain import to_plain
from engine.device import Device
from engine.touch import Touch
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.synthesis import synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.page.choices import Choice, ChoiceError, changed, moved, offered
from tactable.page.live_bar import MOST_MOVING, MOST_POINTS, RATE_HZ, LiveBar, decibels
from tactable.page.view import device_json
from tactable.shipped import find_device

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
