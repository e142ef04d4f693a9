"""Laws of device descriptions: errors name key, value and expectation; the fingerprint is that of the values."""

import re
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device, DeviceError
from engine.device.values import compare_values, device_values
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
TEXT = REFERENCE.text


def bodies_of(text: str) -> dict[str, str]:
    """What stands in each section, its header too; the actuators are numbered."""
    names = ["", *re.findall(r"^\[+(\w+)", text, re.MULTILINE)]
    sections = [f"{name}[{names[:i].count(name)}]" if name == "actuator" else name for i, name in enumerate(names, 1)]
    return dict(zip(sections, re.split(r"^(?=\[)", text, flags=re.MULTILINE), strict=True))


BODIES = bodies_of(TEXT)
KEYS = [(section, key) for section, body in BODIES.items() for key in re.findall(r"^(\w+) =", body, re.MULTILINE)]


def changed(section: str, key: str, value: str | None, text: str = TEXT) -> str:
    """The description with `key = value` (TOML) in that section; None takes the key out."""
    bodies = bodies_of(text)
    line = "" if value is None else f"{key} = {value}\n"
    body, count = re.subn(rf"^{key} = .*\n", lambda _: line, bodies[section], flags=re.MULTILINE)
    bodies[section] = body if count else f"{body.rstrip()}\n{line}\n"
    return "".join(bodies.values())


def without_marks(text: str = TEXT) -> str:
    return re.sub(r"^inferred = .*\n", "", text, flags=re.MULTILINE)


def with_actuators(places: list[str]) -> str:
    """Reference-a with copies of its first actuator at these places."""
    top, bar, left, _, *rest = BODIES.values()
    template = left.replace('name = "left"\n', "")
    return "".join([top, bar, *(template.replace('"16 %"', f'"{place}"') for place in places), *rest])


def with_zones(*zones: str) -> str:
    """Reference-a with these bodies of [[zone]] tables."""
    text = changed("zones", "inferred", None, changed("zones", "count", None))
    return text + "".join(f"\n[[zone]]\n{zone}\n" for zone in zones)


def without_damping(still_damped: str | None = None) -> str:
    """Reference-a with no damping but the finger's and, if asked, that of one section."""
    parts = {section: re.sub(r'(damping = ")\S+', r"\g<1>0", body) for section, body in BODIES.items()}
    return "".join({**parts, **{kept: BODIES[kept] for kept in ("finger", still_damped) if kept}}.values())


def without_section(header: str) -> str:
    return "".join(body for section, body in BODIES.items() if section != header)


def refusal(text: str) -> str:
    with pytest.raises(DeviceError) as error:
        Device.parse(text, "some.toml")
    message = str(error.value)
    assert message.startswith("some.toml: ")
    return message


def differs(text: str) -> bool:
    """Whether the description is of another device than reference-a, by its fingerprint and by its values alike."""
    device = Device.parse(text, "some.toml")
    is_other = device.fingerprint != REFERENCE.fingerprint
    assert bool(compare_values(device_values(REFERENCE), device_values(device))) == is_other
    return is_other


# What is wrong: (section, key, value in TOML, what the message must also say)
WRONG = [
    ("bar", "length", '"279.4"', "has no unit; expected a length such as '1 m'"),
    ("bar", "length", '"0 mm"', "more than 0 m"),
    ("bar", "largest_element", '"1 um"', "at least"),
    ("bar", "damping_of", '"table"', "one of bar, assembly"),
    ("actuator[2]", "stiffness", '"0 N/m"', "more than 0 N/m"),
    ("actuator[1]", "mass", '"-1 g"', "at least 0 kg"),
    ("actuator[2]", "position", '"101 %"', "is off the bar, which is 279.4 mm long"),
    ("actuator[1]", "position", '"-1 %"', "at least 0"),
    ("actuator[1]", "name", '"left, lower"', "a short printable name"),
    ("actuator[1]", "name", '"\\u001b[31mred"', "a short printable name"),  # would command a terminal
    ("", "name", '"a\\u202eb"', "a short printable name"),
    ("actuator[1]", "band", '["300 Hz", "60 Hz"]', "is empty: the first frequency must be below the second"),
    ("actuator[1]", "band", '["60 Hz"]', "two frequencies"),
    ("zones", "count", "0", "a whole number from 1 to 16"),
    ("zones", "count", "17", "a whole number from 1 to 16"),
    ("finger", "spread", "0.5", "a factor of at least 1"),
    ("spread", "stiffness", '"20 %"', "less than 20 %"),
    ("spread", "finger", '"100 %"', "less than 100 %"),
    ("digitizer", "axis", '"z"', "one of x, y"),
    ("digitizer", "flip", '"yes"', "true or false"),
    ("digitizer", "start_margin", '"279.4 mm"', "leave nothing of the bar"),
    ("digitizer", "active_length", '"0 mm"', "more than 0 m"),
    ("sweep", "start", '"0 Hz"', "more than 0 Hz"),
    ("sweep", "stop", '"60 Hz"', "more than 60 Hz"),
    ("sweep", "step", '"0 Hz"', "more than 0 Hz"),
    ("sweep", "amplitude_steps", "101", "a whole number from 1 to 100"),
    ("sweep", "phase_steps", "3", "a whole number from 4 to 360"),
    ("limits", "amplitude", '"0 %"', "more than 0"),
    ("limits", "ramp", '"0 ms"', "at least 1e-06 s"),
    ("bar", "thickness", '"60 mm"', "at most 1/5 of the length: no beam is that thick"),
    ("feel", "levels", "[]", "a list of 1 to 16 levels"),
    ("feel", "levels", '["10 dB", "10 dB"]', "rising levels"),
    ("feel", "levels", '["81 dB"]', "0 to 80 dB above threshold"),
    ("bar", "inferred", '["lenght"]', "is no key of this table; its keys are length, width"),
    ("bar", "inferred", '"length"', "a list of keys"),
    ("", "description", "5", "text"),
    ("bar", "density", '"1e-300 kg/m^3"', "1 to 100000 kg/m^3"),
    ("bar", "youngs_modulus", '"1e290 GPa"', "10000 to 1e+13 Pa"),
    ("actuator[2]", "band", '["400 Hz", "500 Hz"]', "400-500 Hz: has no frequency of the sweep, 60-300 Hz"),
    ("actuator[1]", "band", '["100.2 Hz", "100.8 Hz"]', "100.2-100.8 Hz"),
    ("sweep", "step", '"0.7 Hz"', "the range 60-300 Hz"),
    ("sweep", "step", '"241 Hz"', "the range 60-300 Hz"),
    ("actuator[2]", "name", '"left"', "'left'"),
    ("limits", "amplitude", '"101 %"', "100 %"),
    ("actuator[1]", "clamp", '"20"', "has no unit"),
    ("actuator[1]", "clamp", '"-20 mm"', "at least 0"),
    ("actuator[2]", "delay", '"6 ms"', "expected up to 5 ms"),
    ("actuator[2]", "delay", '"-1 us"', "at least 0"),
    ("actuator[2]", "delay", '"1 mm"', "is a length"),
    ("digitizer", "latency", '"150 ms"', "expected up to 100 ms"),
    ("digitizer", "silence", '"10 ms"', "at least 0.03 s"),
    ("digitizer", "debounce", '"200 ms"', "up to 100 ms"),
]


@pytest.mark.parametrize(("section", "key", "value", "expected"), WRONG, ids=[f"{s}.{k}={v}" for s, k, v, _ in WRONG])
def test_a_wrong_value_is_refused_by_key_value_and_remedy(section: str, key: str, value: str, expected: str) -> None:
    message = refusal(changed(section, key, value))
    assert (f"{section}.{key}: " if section else f"{key}: ") in message
    *_, written = re.findall(r"[^\[\]\"',\s]+", value) or ["[]"]
    assert written.lower() in message.lower()
    assert expected in message


def with_margins(start: str, end: str, active: str | None = None) -> str:
    text = changed("digitizer", "start_margin", f'"{start}"', changed("digitizer", "end_margin", f'"{end}"'))
    return text if active is None else changed("digitizer", "active_length", f'"{active}"', text)


def zone(start_mm: int, stop_mm: int, more: str = "") -> str:
    return f'start = "{start_mm} mm"\nstop = "{stop_mm} mm"\n{more}'


def with_five(table: str) -> str:
    text = re.sub(rf"^\[+{table}\]+.*\n(?:(?!\[).*\n)*", "", TEXT, flags=re.MULTILINE)
    return f"{table} = 5\n{text}"


def clamped(left: str, right: str) -> str:
    return changed("actuator[1]", "clamp", f'"{left}"', changed("actuator[2]", "clamp", f'"{right}"'))


WIDE = bodies_of(clamped("600 mm", "0 mm"))
PLATE = shipped("reference-p").text.replace("[[actuator]]", '[[actuator]]\nclamp = "20 mm"', 1)
REFUSED = {
    "a clamp to another": (
        clamped("460 mm", "0 mm"),
        "actuator[1].clamp: 460 mm: reaches right",
        "(actuator[2].clamp)",
    ),
    "clamps that meet": (clamped("230 mm", "230 mm"), "reaches right or its clamp"),
    "a clamp of all": (
        "".join(WIDE[each] for each in WIDE if each != "actuator[2]"),
        "leaves nothing of the bar to bend",
    ),
    "a clamp of a plate": (PLATE, "actuator[1].clamp", "20 mm", "is for bars"),
    "a misspelt key": (without_marks().replace("\nlength =", "\nlenght ="), "bar.lenght", "'length'"),
    "a table nobody knows": (TEXT + "\n[fingers]\nmass = '1 g'\n", "did you mean 'finger'?"),
    "two actuators in a place": (changed("actuator[2]", "position", '"16 %"'), "actuator[2].position: '44.704", "left"),
    "zones that overlap": (with_zones(zone(0, 60), zone(50, 90)), "zone[2].start: '50 mm'", "zone I,"),
    "a zone that leaves the bar": (with_zones(zone(0, 300)), "zone[1].stop: '300 mm'", "279.4 mm"),
    "a zone of nothing": (with_zones(zone(30, 30)), "zone[1].stop: '30 mm'", "start"),
    "a zone without an end": (with_zones('start = "30 mm"'), "[zone[1]]", "'stop'"),
    "a zone with two ends": (with_zones(zone(0, 30, 'end = "40 mm"')), "zone[1].end: '40 mm'", "unknown key"),
    "two zones of a name": (with_zones(zone(0, 60, 'name = "II"'), zone(60, 90)), "zone[2].name: 'II'"),
    "a count and zones": (TEXT + f"\n[[zone]]\n{zone(0, 60)}", "zones.count: 5", "[[zone]]"),
    "more zones than names": (with_zones(*(zone(5 * i, 5 * i + 5) for i in range(17))), "zone: 17", "at most 16"),
    "hysteresis of a narrow zone": (with_zones(zone(0, 60), zone(60, 63)), "zones.hysteresis: '2 mm'", "zone II"),
    "margins that meet": (with_margins("50 %", "50 %"), "digitizer.end_margin: '139.7 mm'", "nothing of the bar"),
    "an area beside the start": (with_margins("100 %", "-10 mm"), "digitizer.start_margin: ", "nothing of the bar"),
    "an area beside the end": (with_margins("-10 mm", "279.4 mm"), "digitizer.end_margin: ", "nothing of the bar"),
    "an area too short": (with_margins("-10 mm", "0 mm", "10 mm"), "digitizer.active_length: '10 mm'", "from -10 mm"),
    "nothing that damps": (without_damping(), "bar.mass_damping", "bar.stiffness_damping", "actuator[...].damping"),
    "400 digits": (changed("finger", "spread", "1" + "0" * 400), "finger.spread: "),
    "steps beyond number": (changed("sweep", "stop", '"1e200 Hz"', changed("sweep", "step", '"1e-200 Hz"')), "sweep."),
    "a list without end": (changed("actuator[1]", "band", "[" * 100_000), "not TOML"),
    **{f"no {table}": (without_section(table), f"'{table}'") for table in ("bar", "finger", "sweep", "limits")},
    "no zones": (without_section("zones"), "'count'"),
    "17 actuators": (with_actuators([f"{5 * i} %" for i in range(17)]), "actuator: 17", "at most 16 actuators"),
    **{f"{key} = 5": (with_five(key), f"{key}: 5: expected ") for key in ("actuator", "bar", "zones", "finger")},
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_description_that_contradicts_itself_is_refused_by_the_place_and_what_it_meets(case: str) -> None:
    text, *names = REFUSED[case]
    message = refusal(text)
    assert all(name in message for name in names), message


QUANTITIES = [pair for pair in KEYS if pair[1] not in ("inferred", "description", "name")]
HOSTILE = ('"1e999 m"', "nan", "1e999", "1979-05-27T07:32:00Z", "[" * 50 + "]" * 50, "{ m = 5 }", f'"{"9" * 10_000} m"')
"""Quantities that are hostile as texts are those of test_quantity.py."""


@pytest.mark.parametrize("value", HOSTILE, ids=range(len(HOSTILE)))
@pytest.mark.parametrize(("section", "key"), QUANTITIES)
def test_a_hostile_value_is_refused_in_a_short_message(section: str, key: str, value: str) -> None:
    message = refusal(changed(section, key, value))
    assert f"{section}.{key}".strip(".") in message and len(message) < 1000


ASSUMED = (
    *(("spread", key) for key in ("stiffness", "mass", "finger", "finger_position")),
    *(("digitizer", key) for key in ("axis", "flip", "start_margin", "end_margin")),
    ("finger", "spread"),
)
"""Properties of the device that have a default, which is an estimate."""
CHOSEN = (
    *("description", "bar.largest_element", "actuator[1].name", "actuator[2].name", "zones.hysteresis"),
    *("sweep.phase_steps", "feel.levels", "limits.amplitude", "limits.lease", "spread.name"),
)
"""Other keys that have a default."""


@pytest.mark.parametrize(("section", "key"), [pair for pair in KEYS if pair[1] != "inferred"])
def test_a_missing_key_is_named_or_has_a_documented_default(section: str, key: str) -> None:
    text = changed(section, key, None, without_marks())
    if (section, key) in ASSUMED or f"{section}.{key}".strip(".") in CHOSEN:
        Device.parse(text, "some.toml")
    else:
        assert refusal(text).endswith(f"{f'[{section}] ' if section else ''}has no key {key!r}")


@pytest.mark.parametrize("section", ["spread", "digitizer", "feel"])
def test_an_absent_table_has_the_values_of_reference_a_and_the_devices_are_estimates(section: str) -> None:
    device = Device.parse(without_section(section), "some.toml")
    assert device.fingerprint == REFERENCE.fingerprint
    assert {f"{table}.{key}" for table, key in ASSUMED if table == section} <= set(device.inferred)


@pytest.mark.parametrize(("section", "key"), ASSUMED)
def test_a_property_of_the_device_that_nobody_gave_is_an_estimate(section: str, key: str) -> None:
    """Once, whether the file marks the absent key or not; a value that the file gives unmarked is none."""
    given, absent = without_marks(), changed(section, key, None, without_marks())
    assert Device.parse(given, "some.toml").inferred == ()
    assert Device.parse(absent, "some.toml").inferred == (f"{section}.{key}",)
    assert Device.parse(changed(section, key, None), "some.toml").inferred.count(f"{section}.{key}") == 1


@pytest.mark.parametrize("section", ["bar", "actuator[1]", "actuator[2]"])
def test_any_one_damping_is_enough(section: str) -> None:
    assert Device.parse(without_damping(section), "some.toml")


def test_elements_follow_from_the_shortest_wave_of_the_sweep_and_of_clicks() -> None:
    """24 in the shortest wave of the sweep and 10 at 2 kHz, from the formula of bending waves."""
    for stop_hz, top_hz, count in ((300, 2000, 10), (340, 2000, 10), (360, 360, 24), (1260, 1260, 24)):
        bar = Device.parse(changed("sweep", "stop", f'"{stop_hz} Hz"'), "some.toml").bar
        inertia_m2 = bar.thickness_m**2 / 12
        speed = (bar.youngs_modulus_pa * inertia_m2 / bar.density_kg_per_m3 * (2 * np.pi * top_hz) ** 2) ** 0.25
        wave_m = speed / top_hz
        assert bar.largest_element_m == pytest.approx(wave_m / count, rel=1e-12)


@pytest.mark.parametrize(("section", "key"), [pair for pair in KEYS if pair[1] != "inferred"])
def test_an_unknown_key_is_refused_with_the_nearest_name(section: str, key: str) -> None:
    message = refusal(changed(section, f"{key}s", '"1 m"'))
    assert f"{section}.{key}s: ".lstrip(".") in message
    assert f"'1 m': unknown key; did you mean {key!r}?" in message


@pytest.mark.parametrize(("step", "count"), [("240 Hz", 2), ("0.1 Hz", 2401), ("0.3 Hz", 801), ("16 Hz", 16)])
def test_a_step_that_divides_gives_both_ends(step: str, count: int) -> None:
    frequency_hz = Device.parse(changed("sweep", "step", f'"{step}"'), "some.toml").sweep.frequency_hz
    assert len(frequency_hz) == count
    assert frequency_hz[[0, -1]].tolist() == [60.0, 300.0]


def test_a_description_is_utf_8_and_a_byte_order_mark_is_no_part_of_it(tmp_path: Path) -> None:
    path = tmp_path / "bar.toml"
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())
    assert Device.read(path).text == TEXT
    path.write_bytes(TEXT.encode("utf-16"))
    assert Device.read(path).text == TEXT  # by its byte order mark
    path.write_bytes(TEXT.replace("mm", "\u00b5m", 1).encode("cp1252"))
    with pytest.raises(DeviceError, match=re.escape(str(path)) + ".*save it as UTF-8"):
        Device.read(path)


@pytest.mark.parametrize("count", [1, 2, 8])
def test_any_number_of_zone_tables_with_gaps_and_names(count: int) -> None:
    zones = [f'name = "key {i}"\nstart = "{10 * i + 1} %"\nstop = "{10 * i + 9} %"' for i in range(count)]
    device = Device.parse(with_zones(*zones), "some.toml")
    assert [zone.name for zone in device.zones] == [f"key {i}" for i in range(count)]
    assert [zone.length_m for zone in device.zones] == pytest.approx([0.08 * device.bar.length_m] * count)
    assert device.zone_index("key 0") == 0
    with pytest.raises(DeviceError, match="there is no zone 'VII'; zones are key 0"):
        device.zone_index("VII")


SAME = [
    ("bar", "length", '"11 in"'),
    ("bar", "stiffness_damping", '"50.0456 us"'),
    ("bar", "damping_of", '"bar"'),
    ("actuator[2]", "position", '"272.9738 mm"'),
    ("actuator[1]", "band", '["0.06 kHz", "0.3 kHz"]'),
    ("digitizer", "end_margin", '"0 %"'),
    ("feel", "levels", '["10dB", "20.0 dB", "30. dB"]'),
    ("actuator[2]", "delay", '"0 s"'),
    ("digitizer", "latency", '"0 s"'),
]


@pytest.mark.parametrize(("section", "key", "value"), SAME, ids=[f"{s}.{k}={v}" for s, k, v in SAME])
def test_the_same_value_in_other_words_is_that_of_the_same_device(section: str, key: str, value: str) -> None:
    assert not differs(changed(section, key, value))


def test_order_wording_comments_and_marks_do_not_change_the_fingerprint_but_the_order_of_actuators_does() -> None:
    top, bar, left, right, *rest = BODIES.values()
    assert differs("".join([top, bar, right, left, *rest]))
    turned_bar = "\n".join([bar.splitlines()[0], *bar.splitlines()[:0:-1]])
    shuffled = "\n".join([top, *reversed(rest), left, right, turned_bar])
    reworded = changed("", "description", '"another text"')
    uncommented = re.sub(r" *#.*", "", TEXT)
    defaults = changed("limits", "lease", None, without_marks())
    for same in (shuffled, reworded, uncommented, without_marks(), defaults, TEXT.replace("\n", "\r\n")):
        assert not differs(same)


OTHER = {
    "name": '"other"',
    "band": '["60 Hz", "299 Hz"]',
    "count": "4",
    "spread": "2.5",
    "axis": '"y"',
    "flip": "true",
    "start_margin": '"1 mm"',
    "end_margin": '"1 mm"',
    "active_length": '"270 mm"',
    "damping_of": '"assembly"',
    "delay": '"125 us"',
    "latency": '"15 ms"',
    "clamp": '"20 mm"',
    "position": '"20 %"',  # a thousandth further, the right actuator is at the place of the left one
    "start": '"61 Hz"',
    "stop": '"299 Hz"',
    "step": '"2 Hz"',
    "amplitude_steps": "10",
    "phase_steps": "72",
    "amplitude": '"99 %"',
    "levels": '["10 dB", "30 dB"]',
}
NAMELESS = ("spread", "name")  # that of a set of spreads is a word for its values


@pytest.mark.parametrize(
    ("section", "key"),
    [
        *(pair for pair in KEYS if pair[1] not in ("inferred", "description") and pair != NAMELESS),
        *(("digitizer", "active_length"), ("bar", "damping_of"), ("digitizer", "latency")),
        *(("actuator[1]", "delay"), ("actuator[1]", "clamp")),
    ],
)
def test_any_other_value_is_that_of_another_device(section: str, key: str) -> None:
    written = re.search(rf'^{key} = "([0-9.e-]+) ([^"]*)"', BODIES[section], re.MULTILINE)
    value = OTHER.get(key) or (written and f'"{float(written[1]) * 1.001:.12g} {written[2]}"')
    assert value
    assert differs(changed(section, key, value))


@pytest.mark.parametrize("name", ["reference-a", "reference-d", "reference-t"])
def test_the_estimates_of_the_shipped_devices_are_marked_and_the_physical_ones_count(name: str) -> None:
    """docs/theory.md#model: L, B, h, lumped masses, zone edges, bounds; #fingers: the finger."""
    device = shipped(name)
    bar, actuator = "length width thickness", "mass band"
    if name != "reference-a":  # made up: nothing of it is published
        bar += " youngs_modulus density mass_damping stiffness_damping"
        actuator += " position stiffness damping full_scale"
    keys = {"bar": bar, "finger": "mass damping stiffness spread", "spread": "stiffness mass finger finger_position"}
    keys |= {f"actuator[{i}]": actuator for i in range(1, len(device.actuators) + 1)}
    physical = {f"{table}.{key}" for table in keys for key in keys[table].split()}
    assert physical | {"zones.count", "sweep.start", "sweep.stop", "limits.amplitude"} <= set(device.inferred)
    assert set(device.estimated_values) == physical


def test_a_force_at_full_scale_stays_one_and_only_an_inertial_actuator_has_a_moving_mass() -> None:
    force = changed("actuator[1]", "full_scale", '"79 mN"')
    driven = Device.parse(force, "text").actuators[0]
    assert driven.spring_force_n == pytest.approx(0.079) and driven.damper_force_n_s == 0.0
    stiffer = driven.scaled(stiffness=1.1, mass=1.0)
    assert stiffer.spring_force_n == pytest.approx(0.079)
    assert REFERENCE.actuators[0].scaled(stiffness=1.1, mass=1.0).full_scale_m == REFERENCE.actuators[0].full_scale_m
    inertial = changed("actuator[1]", "moving_mass", '"2 g"', changed("actuator[1]", "kind", '"inertial"', force))
    assert Device.parse(inertial, "text").actuators[0].moving_mass_kg == pytest.approx(2e-3)
    for text, key in ((changed("actuator[1]", "kind", '"grounded"', inertial), "moving_mass"), (inertial, "kind")):
        with pytest.raises(DeviceError, match=rf"actuator\[1\]\.{key}"):
            Device.parse(text.replace('"inertial"', '"floating"'), "text")


def test_a_clamp_lies_about_its_actuator_and_ends_with_the_bar() -> None:
    device = Device.parse(clamped("20 mm", "20 mm"), "text")
    ends_m = [actuator.clamped_m(device.bar.length_m) for actuator in device.actuators]
    left_m, right_m = (actuator.position_m.real for actuator in device.actuators)
    assert ends_m[0] == pytest.approx((left_m - 0.01, left_m + 0.01))
    assert ends_m[1] == pytest.approx((right_m - 0.01, device.bar.length_m))
