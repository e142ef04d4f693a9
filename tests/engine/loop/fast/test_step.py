"""The compiled step beside the Python pipeline: the same bytes whatever fingers do, and most clicks are its own."""

import ctypes
import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import engine.loop.fast.library as library_module
from engine.device import Device
from engine.effects.rules import Drives, Effects, Rule, Trigger, click
from engine.loop.observer import CommandRecord, Fate
from engine.table.best_rows import BestRows
from engine.touch.sources.recording import Recording
from tests.engine.loop.fast.scripts import (
    LOUD_DB,
    device_with_gaps,
    plate_device,
    random_frames,
    random_rules,
    report,
    varied_clicks,
)
from tests.engine.loop.fast.test_fast_path import FastRig, on_sockets
from tests.engine.loop.rig import DEVICE, SLOTS, Rig, recording_of
from tests.engine.made_table import LEVEL_DB, rows_of
from tests.engine.touch.descriptors import BLOB, CONTACT_COUNT, application, finger
from tests.quick import first_quick
from tests.tools.guard import allowed
from tests.tools.virtual import VirtualLine

GAPS = device_with_gaps()
# Its digitizer is longer than the bar at both ends.
WIDE = replace(DEVICE, touch_axis=replace(DEVICE.touch_axis, start_margin_m=-0.05, end_margin_m=-0.05))
PLATE = plate_device()
CLICKS = {device: varied_clicks(device) for device in (DEVICE, GAPS, PLATE)}
EVERY_CLICK = {device: varied_clicks(device, missing=10**6) for device in (DEVICE, GAPS, WIDE)}
TOUCH = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))
TOUCH_AND_LIFT = Effects((*TOUCH.rules, Rule(Trigger.LIFT, click(LOUD_DB))))
STARTED_NS = 1_234_567_000
"""When the device started, by the clock of the host."""


@pytest.fixture(autouse=True)
def library(fast_library: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FastRig, "library", fast_library)


@dataclass(frozen=True)
class Both:
    """A run with the fast path, and the commands that the run without it gave to reports."""

    fast: Rig
    answered: int
    clicks: list[CommandRecord]
    """Written for a report, one finger or two."""


def both(
    recording: Recording,
    effects: Effects,
    device: Device = DEVICE,
    *,
    refuses: bool = False,
    is_complete: bool = False,
    rows: BestRows | None = None,
) -> Both:
    """Run with and without the fast path, which do the same."""
    clicks = (EVERY_CLICK if is_complete else CLICKS)[device]
    slow, fast = (
        rig(
            recording,
            line=VirtualLine(booted_ns=STARTED_NS),
            effects=effects,
            device=device,
            clicks=clicks,
            rows=rows,
            refuses=refuses,
        ).run()
        for rig in (Rig, FastRig)
    )
    assert fast.trace == slow.trace
    assert fast.log == slow.log
    assert fast.loop.counters == slow.loop.counters
    few = [record for record in slow.trace if record.placement is not None and len(record.placement.position_m) <= 2]
    played = [record for record in few if record.is_click and record.fate is Fate.WRITTEN and not record.drive]
    counters = fast.session.fast_counters
    return Both(fast, counters.answered, [record for record in played if record.report_index is not None])


devices = pytest.mark.parametrize("device", [DEVICE, GAPS, PLATE], ids=["zones side by side", "gaps", "plate"])


def random_run(random: np.random.Generator, device: Device, drives: Drives, rows: BestRows | None) -> Both:
    """The same with and without the fast path, whatever fingers do and rules say."""
    frames, rules = random_frames(random, 14), random_rules(random, device)
    refuses = random.random() < 0.3
    return both(recording_of(*frames), Effects(rules, drives=drives), device, refuses=bool(refuses), rows=rows)


@devices
@pytest.mark.parametrize("seed", first_quick(range(2)))
def test_whatever_fingers_do_and_rules_say_the_run_is_the_same(device: Device, seed: int) -> None:
    random = np.random.default_rng(seed)
    runs = [random_run(random, device, Drives.POSITIONS, None) for _ in range(25)]
    due = sum(len(run.clicks) for run in runs)
    # What is left to the loop: clicks that the table has not, palms, and fingers that move under rules on moves.
    assert due > 20
    assert 0.4 * due < sum(run.answered for run in runs)


@pytest.mark.parametrize("drives", Drives)
@devices
def test_with_drives_of_zones_the_run_is_the_same_too(device: Device, drives: Drives) -> None:
    """Those of a table that plays clicks beside them, and those that take the place of clicks."""
    random, rows = np.random.default_rng(7), rows_of(device, (LEVEL_DB, math.inf), short_of=(1,))
    runs = [random_run(random, device, drives, rows) for _ in range(16)]
    due = sum(each.report_index is not None and each.fate is Fate.WRITTEN for run in runs for each in run.fast.trace)
    # What is left to the loop: drives after a click, and fingers that move.
    assert due > 40
    assert 0.25 * due < sum(run.answered for run in runs)


def touch_in(*zones: int) -> Effects:
    return Effects((Rule(Trigger.TOUCH, click(LEVEL_DB), zones=frozenset(zones)),))


Frames = list[tuple[float, bytes]]
IDLE = (0.0, report({}))
"""The first report finds the line busy, which was only just armed."""


def answered_whole(
    frames: Frames, effects: Effects = TOUCH, device: Device = DEVICE, **digitizer: object
) -> list[tuple[tuple[float, ...], tuple[bool, ...]]]:
    """Positions in mm and roles of the clicks of a run, all of which the compiled step answered."""
    recording = replace(recording_of(IDLE, *frames), **digitizer)  # type: ignore[arg-type]  # its fields
    found = both(recording, effects, device, is_complete=True)
    assert found.answered == len(found.clicks)
    placements = [record.placement for record in found.clicks if record.placement is not None]
    return [(tuple(round(1e3 * at_m.real, 1) for at_m in each.position_m), each.is_felt) for each in placements]


def test_clicks_of_one_finger_and_of_two_are_answered() -> None:
    frames = [(0.1, report({1: 0.1})), (0.2, report({1: 0.1, 2: 0.5})), (0.3, report({2: 0.5}, [1]))]
    frames += [(0.4, report({}, [2])), (0.5, report({4: 0.4, 5: 0.9})), (0.6, report({}, [4, 5]))]
    # The clock reference begins again every 6.6 s.
    assert answered_whole([*frames, (10.0, report({1: 0.1})), (10.1, report({}, [1]))]) == [
        ((27.9,), (True,)),
        ((27.9, 139.7), (False, True)),
        ((111.8, 251.5), (True, True)),
        ((27.9,), (True,)),
    ]


def test_fingers_that_are_one_to_the_bar_are_left_to_the_loop() -> None:
    # Both times they are nearest to different places, first 5.6 mm apart and then 8.4 mm.
    frames = [IDLE, (0.1, report({1: 0.44, 2: 0.46})), (0.2, report({}, [1, 2])), (0.3, report({1: 0.435, 2: 0.465}))]
    found = both(recording_of(*frames, (0.4, report({}, [1, 2]))), TOUCH, is_complete=True)
    assert [len(record.placement.position_m) for record in found.clicks if record.placement] == [1, 2]
    assert found.answered == 1


def test_fingers_in_gaps_between_zones_are_fingers() -> None:
    frames = [(0.1, report({1: 0.4})), (0.2, report({1: 0.4, 2: 0.6})), (0.3, report({1: 0.4}, [2]))]
    frames += [(0.4, report({1: 0.4, 3: 0.98})), (0.5, report({}, [1, 3]))]
    assert answered_whole(frames, device=GAPS) == [
        ((111.8,), (True,)),
        ((111.8, 167.6), (False, True)),
        ((111.8, 273.8), (False, True)),
    ]
    # Only the second lies in a zone; the first is quiet in its gap.
    assert answered_whole(frames, touch_in(0, 1), GAPS) == [((111.8, 167.6), (False, True))]


@pytest.mark.parametrize("zone", range(5))
def test_a_finger_on_an_edge_is_in_the_zone_that_starts_there_as_in_the_loop(zone: int) -> None:
    """Some of the edges are positions of the digitizer to the last bit; between two edges a finger is in the zone."""
    frames: Frames = []
    for half in range(11):
        frames += [(0.1 + 0.1 * half, report({1: 0.1 * half})), (0.15 + 0.1 * half, report({}, [1]))]
    assert answered_whole(frames, touch_in(zone))


def test_a_region_has_both_of_its_ends() -> None:
    length_m = DEVICE.bar.length_m
    regions = Effects(
        tuple(
            Rule(Trigger.TOUCH, click(LEVEL_DB), region_m=region_m)
            for region_m in ((0.0, 0.01), (length_m - 0.01, length_m))
        )
    )
    frames: Frames = [(0.1, report({1: 0.0})), (0.2, report({}, [1])), (0.3, report({1: 1.0})), (0.4, report({}, [1]))]
    assert answered_whole(frames, regions) == [((0.0,), (True,)), ((279.4,), (True,))]


def test_a_click_under_way_keeps_its_fingers() -> None:
    frames = [(0.1, report({1: 0.1, 2: 0.5})), (0.104, report({1: 0.1, 2: 0.55})), (0.108, report({1: 0.1}, [2]))]
    frames += [(0.112, report({1: 0.1, 3: 0.9})), (0.116, report({1: 0.15, 3: 0.9})), (0.2, report({}, [1, 3]))]
    assert answered_whole(frames, touch_in(0)) == [((27.9, 139.7), (True, False))]


def test_a_finger_that_lifts_is_felt_where_it_was_by_its_lift_rule() -> None:
    frames = [(0.1, report({1: 0.1, 2: 0.5})), (0.2, report({2: 0.5}, [1])), (0.21, report({2: 0.5, 3: 0.9}))]
    clicks = answered_whole([*frames, (0.3, report({}, [2, 3]))], TOUCH_AND_LIFT)
    assert clicks[:2] == [((27.9, 139.7), (True, True)), ((27.9, 139.7), (True, False))]
    # The click of the lifted finger is cut by that of the next, and it does not touch.
    assert clicks[2] == ((139.7, 251.5), (False, True))


@pytest.mark.parametrize(("units", "place_m"), [(1, 0.0), (2, 1.0)])
def test_a_finger_counts_where_it_is_held_not_where_it_jitters(units: int, place_m: float) -> None:
    """A unit of the digitizer is 0.28 mm, a finger is followed from 0.5 mm on, and two places meet at unit 50."""
    frames = [(0.1, report({1: 0.049})), (0.2, report({1: 0.049 + 0.001 * units}))]
    frames += [(0.3, report({1: 0.049 + 0.001 * units, 2: 0.9})), (0.4, report({}, [1, 2]))]
    ((position_mm, is_felt),) = answered_whole(frames, touch_in(4))
    assert is_felt == (False, True)
    assert position_mm[0] == round((49 + units * place_m) * 0.2794, 1)


@pytest.mark.parametrize(("bars_per_s", "ahead_mm"), [(0.0, 0.0), (0.125, 1.0), (-0.5, -3.9), (1.0, 7.8), (2.5, 15.0)])
def test_a_click_is_made_for_where_a_finger_that_slides_will_be(bars_per_s: float, ahead_mm: float) -> None:
    """A finger slides over the bar, 279.4 mm long, and another comes down; the click's peak is 28 ms after that."""
    frames = [(0.1 + t_s, report({1: 0.3 + bars_per_s * t_s})) for t_s in np.arange(7) * 0.008]
    at = 0.3 + bars_per_s * 0.056
    frames += [(0.156, report({1: at, 2: 0.95})), (0.3, report({}, [1, 2]))]
    ((position_mm, is_felt),) = answered_whole(frames, touch_in(4))
    assert is_felt == (False, True) and position_mm[1] == 265.4
    assert position_mm[0] == pytest.approx(279.4 * at + ahead_mm, abs=0.31)


def test_a_step_of_less_than_a_finger_is_followed_by_is_none() -> None:
    """It moves by 0.28 mm in 16 ms, 0.49 mm until the peak; two places meet where it is, and it is held before that."""
    frames = [(0.1, report({1: 0.049})), (0.116, report({1: 0.05, 2: 0.9})), (0.3, report({}, [1, 2]))]
    ((position_mm, _),) = answered_whole(frames, touch_in(4))
    assert position_mm[0] == 13.7


def test_a_finger_midway_between_two_places_belongs_to_the_same_one_as_in_the_loop() -> None:
    """Places are 100 units of the digitizer apart: it is the upper one, but for rounding."""
    frames: Frames = []
    for number in range(10):
        frames += [(0.1 + 0.1 * number, report({1: 0.05 + 0.1 * number})), (0.15 + 0.1 * number, report({}, [1]))]
    assert len(answered_whole(frames)) == 10


def test_what_time_brings_at_the_time_of_a_report_comes_before_it() -> None:
    """The click of the hold begins first, and the one that comes at the same time does not change it."""
    hold = Rule(Trigger.HOLD, click(LEVEL_DB), zones=frozenset({0}), after_ns=20_000_000)
    effects = Effects((Rule(Trigger.TOUCH, click(LOUD_DB), zones=frozenset({4})), hold))
    frames = [IDLE, (0.1, report({1: 0.1})), (0.12, report({1: 0.1, 2: 0.9})), (0.2, report({}, [1, 2]))]
    found = both(recording_of(*frames), effects, is_complete=True)
    assert (found.answered, found.clicks) == (0, [])


@pytest.mark.parametrize(("vendor_id", "product_id", "last"), [(0x0408, 0x3001, 9), (0x0486, 0x0185, 10)])
def test_the_last_contact_of_a_digitizer_that_counts_its_contacts_is_answered(
    vendor_id: int, product_id: int, last: int
) -> None:
    frames = [(0.1, report({last: 0.1})), (0.2, report({last + 1: 0.5}))]
    counts = application(*(finger(flags="0942 0947") for _ in range(SLOTS)), CONTACT_COUNT)
    assert len(answered_whole(frames, descriptor=counts, vendor_id=vendor_id, product_id=product_id)) == 1


TWO = [((27.9,), (True,)), ((167.6,), (True,))]


def test_a_finger_that_comes_after_another_lifted_in_the_same_report_is_answered() -> None:
    slots = struct.pack("<BBHHBBHH", 4, 1, 0, 500, 7, 2, 600, 500).ljust(6 * SLOTS, b"\0")
    assert answered_whole([(0.1, report({1: 0.1})), (0.2, b"\x01" + slots + b"\x02")]) == TWO


def test_the_report_that_completes_a_frame_is_answered_for_the_contacts_of_those_before_too() -> None:
    panel = application(finger(flags="0942 0932 0947"), CONTACT_COUNT, BLOB)
    slots = [
        struct.pack("<BBBHHB", 1, 7, contact, place, 500, count) for contact, place, count in ((1, 100, 2), (2, 600, 0))
    ]
    found = answered_whole([(0.1, slots[0]), (0.102, slots[1])], descriptor=panel)
    assert found == [((27.9, 167.6), (True, True))]


def test_a_contact_that_a_panel_no_longer_mentions_has_lifted() -> None:
    frames = [(0.1, report({1: 0.1})), (0.15, report({2: 0.6})), (0.2, report({}))]
    assert answered_whole(frames, vendor_id=0x17EF, product_id=0x60FE) == TWO


def test_a_contact_that_hovers_feels_nothing_until_it_touches() -> None:
    """The second flag is In Range: without the first the contact of a Windows 8 panel is there, and does not touch."""
    hover = report({1: 0.1}).replace(b"\x07", b"\x06", 1)
    frames = [(0.1, hover), (0.15, report({1: 0.1})), (0.2, hover), (0.3, report({2: 0.6}))]
    panel = application(*(finger() for _ in range(SLOTS)), CONTACT_COUNT, BLOB)
    assert answered_whole(frames, descriptor=panel) == TWO


def test_places_may_be_signed_numbers_and_reports_without_a_number() -> None:
    signed = finger().replace(b"\x26\xe8\x03", b"\x16\x0c\xfe\x26\xf4\x01")
    descriptor = application(*([signed] * SLOTS), CONTACT_COUNT, report_id=None)
    slots = struct.pack("<BBhh", 3, 1, -400, 0).ljust(6 * SLOTS, b"\0")
    frames = [(0.1, slots + b"\x01"), (0.15, report({}, [1])[1:])]
    assert answered_whole(frames, descriptor=descriptor) == TWO[:1]


@pytest.mark.parametrize(("cut_s", "whole"), [(0.14, report({1: 0.1})), (0.3, report({2: 0.6}))])
def test_a_report_that_is_cut_off_brings_nothing_and_lifts_no_finger(cut_s: float, whole: bytes) -> None:
    """Behind its end lies the report before, whose contact count would make it whole."""
    frames = [(0.1, report({1: 0.1})), (0.18, report({}, [1])), (cut_s, whole[:8])]
    assert answered_whole(sorted(frames), TOUCH_AND_LIFT) == TWO[:1] * 2


@pytest.mark.parametrize(("place", "zone"), [(0.115, 0), (0.885, 4)])
def test_a_finger_beyond_an_end_of_the_bar_is_at_that_end(place: float, zone: int) -> None:
    frames = [(0.1, report({1: place})), (0.2, report({}, [1]))]
    ((position_mm, _),) = answered_whole(frames, touch_in(zone), WIDE)
    assert position_mm == (0.0 if zone == 0 else 279.4,)


def test_more_than_64_contacts_stay_within_bounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """More contacts than the compiled step has room for come, lift one after another, and come in parts of frames."""
    monkeypatch.setattr(library_module, "_FLAGS", (*library_module._FLAGS, "-fsanitize=undefined"))
    with allowed("compiles the step with the sanitizer"):
        library = library_module.compile_fast_path(tmp_path)
    monkeypatch.setattr(FastRig, "library", library)
    slots, most = 40, 127
    maximum = bytes.fromhex(f"8502 050d 0955 1500 25{most:02x} 7508 9501 b102")
    descriptor = application(*(finger() for _ in range(slots)), CONTACT_COUNT, maximum)
    frames: Frames = []
    # The second 127 come while effects of 30 that have lifted go on, and lift in four parts of a frame.
    counts = (1, 60, 64, 65, 100, 90, 66, 63, 2, 1, 2, 127, 97, 127, 10, 1)
    starts_s = np.cumsum([0.1, *(0.008 if count >= 97 or count == 10 else 0.05 for count in counts[1:])])
    for start_s, count in zip(starts_s.tolist(), counts, strict=True):
        contacts = [struct.pack("<BBHH", 3, contact, 10 * contact, 500) for contact in range(count)]
        contacts += [struct.pack("<BBHH", 0, contact, 0, 500) for contact in range(count, most)]
        for first in range(0, most, slots):
            part = b"".join(contacts[first : first + slots]).ljust(6 * slots, b"\0")
            frames.append((start_s + 0.001 * first / slots, b"\x01" + part + bytes([most * (first == 0)])))
    recording = replace(recording_of(*frames), descriptor=descriptor)
    for rules in (TOUCH, TOUCH_AND_LIFT):
        assert both(recording, rules, is_complete=True).fast.loop.counters.frames > 10
    with on_sockets(library) as ends:
        others = [ends.port, ends.ours, ends.device, ends.port]
        assert ends.fast.wait(0, [each.fileno() for each in others], ()) == []
    assert "runtime error" not in capfd.readouterr().err  # as the sanitizer says it


def test_an_id_that_comes_down_in_the_report_in_which_it_lifted_is_another_finger_to_both() -> None:
    again = struct.pack("<BBHHBBHH", 4, 1, 100, 500, 7, 1, 900, 500).ljust(6 * SLOTS, b"\0")
    frames = [
        (0.1, report({1: 0.1})),
        (0.3, b"\x01" + again + b"\x02"),
        (0.5, report({1: 0.9, 2: 0.1})),
        (0.7, report({}, [1, 2])),
    ]
    found = both(recording_of(*frames), TOUCH, is_complete=True)
    assert len(found.clicks) == 3
