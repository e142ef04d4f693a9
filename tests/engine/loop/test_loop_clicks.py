"""Clicks through the loop, to an emulated firmware in virtual time."""

from engine.effects.rules import DEFAULT_EFFECTS, Effect, Effects, Rule, Segment, Trigger, click
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause, DriveEvent
from tests.engine.loop.rig import DEVICE, Rig, held, index_of, recording_of, report
from tests.engine.made_clicks import click_of, in_zones, made_clicks, number_of
from tests.engine.made_states import LEVEL_DB
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True
PLACEMENTS = [in_zones(DEVICE, [0]), in_zones(DEVICE, [2], [0]), in_zones(DEVICE, [0, 2]), in_zones(DEVICE, [1])]
CLICKS = made_clicks(DEVICE, [click_of(DEVICE, placement, level_db=26.0) for placement in PLACEMENTS])
SOFT = 10 ** (-6 / 20)
RULES = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))


def waveform_of(event: DriveEvent) -> int | None:
    numbers = [number_of(DEVICE, placement) for placement in PLACEMENTS]
    return None if event.waveform is None else numbers.index(int(event.waveform.samples[1, 0]))


def plays(rig: Rig) -> list[tuple[float, int | None]]:
    """Time in ms from the first touch, and waveform, of each waveform that the firmware began."""
    first_us = rig.start_ns / 1000
    return [
        (int((event.device_time_us - first_us) / 1000), waveform_of(event))
        for event in rig.log
        if event.cause is Cause.PLAY and event.waveform is not None
    ]


def test_a_touch_plays_the_click_of_its_state_at_the_level_of_its_rule() -> None:
    rig = Rig(recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1]))), effects=RULES, clicks=CLICKS).run()
    assert rig.states() == [index_of(0), 0]
    assert [change.is_click for change in rig.trace] == [True, False]
    (event,) = [event for event in rig.log if event.waveform is not None]
    assert event.waveform is not None
    assert abs(event.waveform.amplitude - SOFT) < 1e-4
    assert plays(rig) == [(0, 0)]
    assert event.sequence == rig.trace[0].drive_sequence


def test_a_lift_does_not_cut_a_click() -> None:
    frames = [(0.0, report((1, 0.1))), (0.01, report(lifted=[1])), (0.1, report())]
    rig = Rig(recording_of(*frames), effects=RULES, clicks=CLICKS).run()
    (start,) = [event for event in rig.log if event.waveform is not None]
    later = rig.log[rig.log.index(start) + 1 :]
    assert all(event.device_time_us - start.device_time_us >= 30_000 for event in later)
    assert rig.trace[1].drive_sequence is None


def test_a_click_that_never_left_is_not_played_late() -> None:
    line = VirtualLine()
    frames = [(0.0, report()), *held(0.02, 0.1, (1, 0.1)), *held(0.1, 0.2, (1, 0.3)), (0.2, report(lifted=[1]))]
    rig = Rig(recording_of(*frames), line, effects=RULES, clicks=CLICKS)
    line.stall_at_ns, line.stall_ns = rig.start_ns + 5 * MS, 150 * MS
    rig.run()
    assert [change.is_click for change in rig.trace] == [True, False]
    assert plays(rig) == []


def test_what_is_held_goes_on_after_a_click() -> None:
    held_rule = Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),)), zones=frozenset({0}))
    effects = Effects((held_rule, Rule(Trigger.TOUCH, click(LEVEL_DB))))
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.3, (1, 0.1), (2, 0.5)), (0.3, report(lifted=[1, 2]))]
    rig = Rig(recording_of(*frames), effects=effects, clicks=CLICKS).run()
    driven = [
        (event.cause, round(event.channels[0].frequency_hz * bool(event.channels[0].amplitude), 2)) for event in rig.log
    ]
    assert [what for what in driven if what[1]] == [(Cause.SET, 101.0), (Cause.SET, 101.25)]
    assert [waveform for _, waveform in plays(rig)] == [1]


def test_a_device_that_plays_no_clicks_gets_the_steady_drive_for_as_long() -> None:
    configuration = DeviceConfiguration(0x5EED, basis_capacity_bytes=0)
    rig = Rig(
        recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1]))),
        VirtualLine(configuration),
        effects=DEFAULT_EFFECTS,
        clicks=CLICKS,
    ).run()
    assert rig.played() == [101.0, 0.0]
    assert abs(1000 * (rig.log[1].device_time_us - rig.log[0].device_time_us) - 30 * MS) < MS


def test_after_a_reconnect_an_old_click_is_not_played() -> None:
    line = VirtualLine()
    frames = [*held(0.0, 1.0, (1, 0.1)), (1.0, report(lifted=[1]))]
    rig = Rig(recording_of(*frames), line, effects=RULES, clicks=CLICKS, reconnect=True)
    line.stall_at_ns = rig.start_ns + 500 * MS
    rig.run()
    assert rig.loop.counters.reconnects == 1
    assert [waveform for _, waveform in plays(rig)] == [0]
