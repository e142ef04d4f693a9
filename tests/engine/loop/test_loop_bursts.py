"""Bursts through the loop, to an emulated firmware without waveforms in virtual time."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from engine.effects import Effects, Rule, Trigger
from engine.effects.rules import click
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.firmware import DeviceConfiguration, EmulatedFirmware
from firmware_link.protocol.messages import SHAPE_FULL_GAIN
from tests.engine.loop.test_loop import DEVICE, MS, Rig, VirtualLine, entry_for, held, index_of, recording_of, report
from tests.engine.made_bursts import SHAPES, burst_of
from tests.engine.made_entries import LEVEL_DB, states_of

RUNS_BOTH_WAYS = True
ALONE = burst_of(DEVICE, states_of(DEVICE, [0]), frequency_hz=150.0, stop_s=0.02)
OTHER = burst_of(DEVICE, states_of(DEVICE, [2], [0]), frequency_hz=160.0, shape=1, stop_s=0.015)
LEVEL = 10 ** ((LEVEL_DB - 26.0) / 20)
RULES = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))
DOWN = tuple(held(0.0, 0.2, (1, 0.1)))
LIFTED = (0.2, report(lifted=[1]))


def plain_line() -> VirtualLine:
    return VirtualLine(firmware=EmulatedFirmware(DeviceConfiguration(0x5EED, bank_capacity_bytes=0)))


@dataclass
class BurstRig(Rig):
    line: VirtualLine = field(default_factory=plain_line)
    effects: Effects = RULES

    def __post_init__(self) -> None:
        self.bursts, self.shapes = (ALONE, OTHER), SHAPES
        super().__post_init__()

    def run(self) -> BurstRig:
        super().run()
        return self

    def driven(self) -> list[tuple[Cause, float, float, float]]:
        """Cause, ms since the first event, and frequency and amplitude of the first actuator, of each event."""
        first_us = self.log[0].device_time_us if self.log else 0
        return [
            (
                event.cause,
                round((event.device_time_us - first_us) / 1000, 1),
                event.channels[0].frequency_hz,
                event.channels[0].amplitude,
            )
            for event in self.log
        ]


def test_a_touch_begins_the_burst_of_its_state_and_silence_ends_it_at_its_stop() -> None:
    rig = BurstRig(recording_of(*DOWN, LIFTED)).run()
    amplitude = 0.4 * LEVEL
    expected = [(Cause.SET, 0.0, SHAPES[0][0].gain)]
    for step, gain in zip(SHAPES[0], (0.25, 1.5, 1.0), strict=True):
        expected.append((Cause.ONSET, 1000 * step.until_s, gain))
    *course, end = rig.driven()
    assert [(cause, at_ms) for cause, at_ms, *_ in course] == [each[:2] for each in expected]
    assert [each[3] for each in course] == pytest.approx(
        [amplitude * gain for *_, gain in expected], abs=1 / SHAPE_FULL_GAIN
    )
    assert (end[0], end[1], end[3]) == (Cause.SET, 20.0, 0.0)
    assert [change.state for change in rig.trace] == [index_of(0), index_of(quiet=[0]), 0]
    assert [change.drive_sequence is None for change in rig.trace] == [False, True, True]
    assert (rig.loop.counters.commands, rig.renderer.unknown_states) == (1, 0)


def test_a_lift_before_the_stop_is_silence_at_once() -> None:
    rig = BurstRig(recording_of((0.0, report((1, 0.1))), (0.006, report(lifted=[1])), (0.1, report()))).run()
    assert rig.states() == [index_of(0), 0]
    begun, ended = (each for each in rig.driven() if each[0] is Cause.SET)
    assert begun[3] > 0.0 == ended[3]
    assert ended[1] == pytest.approx(6.0, abs=0.5)


def test_a_newer_touch_replaces_the_burst_and_its_stop() -> None:
    frames = [*held(0.0, 0.016, (1, 0.1)), *held(0.016, 0.2, (1, 0.1), (2, 0.5)), (0.2, report(lifted=[1, 2]))]
    rig = BurstRig(recording_of(*frames)).run()
    sets = [(at_ms, hz if amplitude else 0.0) for cause, at_ms, hz, amplitude in rig.driven() if cause is Cause.SET]
    (_, first_hz), (second_ms, second_hz), (end_ms, end_hz) = sets
    assert [first_hz, second_hz, end_hz] == pytest.approx([150.0, 160.0, 0.0], abs=0.01)
    assert second_ms == pytest.approx(16.0, abs=0.5)
    assert end_ms - second_ms == pytest.approx(1000 * OTHER.stop_s, abs=0.5)


def test_bursts_after_one_another_are_each_shaped() -> None:
    frames = [*DOWN[:8], (0.064, report(lifted=[1])), *held(0.1, 0.2, (2, 0.1)), (0.2, report(lifted=[2]))]
    rig = BurstRig(recording_of(*frames)).run()
    assert [cause for cause, *_ in rig.driven()] == [Cause.SET, *[Cause.ONSET] * 3, Cause.SET] * 2


def test_a_burst_that_could_not_leave_while_its_click_lasts_never_does() -> None:
    rig = BurstRig(
        recording_of(*DOWN, LIFTED), bit_rate_hz=4800
    ).run()  # what armed the device takes the line for 40 ms
    assert [change.is_click for change in rig.trace] == [True, False, False]
    assert rig.trace[0].drive_sequence is None
    assert not any(amplitude for *_, amplitude in rig.driven())


def test_after_a_reconnect_an_old_burst_is_not_played() -> None:
    rig = BurstRig(recording_of(*held(0.0, 1.0, (1, 0.1)), (1.0, report(lifted=[1]))), reconnect=True)
    rig.line.stall_at_ns = rig.start_ns + 5 * MS
    rig.run()
    assert rig.loop.counters.reconnects == 1
    starts = [each for each in rig.driven() if each[0] is Cause.SET and each[3]]
    assert len(starts) == 1


def test_a_state_without_a_burst_is_the_steady_drive_for_as_long_as_a_click() -> None:
    frames = [*held(0.0, 0.2, (1, 0.3)), (0.2, report(lifted=[1]))]
    rig = BurstRig(recording_of(*frames), entries=[entry_for(1)]).run()
    assert [cause for cause, *_ in rig.driven()] == [Cause.SET] * 2
    assert rig.driven()[1][1] == pytest.approx(30.0, abs=0.5)


def test_a_device_that_plays_waveforms_is_told_no_shapes() -> None:
    rig = BurstRig(recording_of(*DOWN, LIFTED), line=VirtualLine()).run()
    assert rig.session.link.configuration.onsets == ()
    assert Cause.ONSET not in [event.cause for event in rig.log]
