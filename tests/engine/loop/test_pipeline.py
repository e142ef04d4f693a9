"""Laws of the one pure step: what a report and time bring, that the loop runs just this, and which frequency stays."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from engine.effects.rules import Effect, Effects, Rule, Segment, Trigger, burst
from engine.loop.pipeline import SAME_FINGER_M, HeldDrive, Pipeline, open_pipeline
from engine.render.renderer import SILENCE, Command, DriveCommand
from engine.touch import Placement
from engine.touch.sources.recording import Recording, read_recording
from tests.engine.loop.rig import DEVICE, HELD, Rig, recording_of, report
from tests.engine.made_table import LEVEL_DB
from tests.engine.shared_recordings import recording_params
from tests.tools.virtual import MS

EVERY_TRIGGER = Effects(
    (
        Rule(Trigger.TOUCH, burst(LEVEL_DB, 50)),
        Rule(Trigger.DRAG, Effect("texture", (Segment(20 * MS, 30.0), Segment(None, LEVEL_DB))), every_m=5e-3),
        Rule(Trigger.HOLD, Effect("purr", (Segment(None, LEVEL_DB),)), after_ns=200 * MS),
        Rule(Trigger.LIFT, burst(30.0, 20)),
    )
)


def pipeline_of(rig: Rig, stamps: itertools.count[int] | None = None) -> Pipeline:
    """A pipeline like that of the rig's loop, with its fingers and effects at their start."""
    arguments = (rig.recording, DEVICE, rig.effects, rig.renderer)
    return open_pipeline(*arguments) if stamps is None else open_pipeline(*arguments, lambda: next(stamps))


def played(pipeline: Pipeline, recording: Recording) -> list[tuple[int, Placement | None, float | None, Command]]:
    """(time, placement, level, command) of each change that the reports and time bring."""
    found = list[tuple[int, Placement | None, float | None, Command]]()
    for entry in recording.reports:
        time_ns = round(1e9 * entry.time_s)
        found += ((time_ns, *pipeline.wanted[:2], command) for command in pipeline.commands_due(time_ns))
        brought = pipeline.step(entry.data, time_ns)
        if brought is not None:
            found.append((time_ns, *pipeline.wanted[:2], brought))
    found += ((10**18, *pipeline.wanted[:2], command) for command in pipeline.commands_due(10**18))
    return found


def test_a_drive_that_follows_a_finger_is_told_the_frequency_before() -> None:
    steps = [(0.1 * k, report((1, 0.1 + 0.01 * k))) for k in range(3)]
    rig = Rig(recording_of(*steps, (0.3, report(lifted=[1])), (0.4, report((1, 0.12)))))
    changes = played(pipeline_of(rig), rig.recording)
    hz = rig.steady.frequency_hz(Placement.on(DEVICE, [0.1 * DEVICE.bar.length_m]))
    assert [command.frequency_hz for *_, command in changes] == [hz, hz, hz, None, hz, None]
    assert rig.steady.held_hz == [None, hz, hz, None]


def test_silence_is_a_command_only_where_something_is_wanted() -> None:
    rig = Rig(recording_of((0.0, report((1, 0.1)))))
    pipeline = pipeline_of(rig)
    assert pipeline.silence() is None
    pipeline.step(rig.recording.reports[0].data, 0)
    assert pipeline.silence() == SILENCE
    assert pipeline.silence() is None


@pytest.mark.parametrize("effects", [HELD, EVERY_TRIGGER])
@pytest.mark.parametrize("path", recording_params("touch", "*.hid", long_but=1)[::3])
def test_the_loop_runs_what_the_pipeline_gives(path: Path, effects: Effects) -> None:
    rig = Rig(read_recording(path), effects=effects)
    expected = [(placement, level_db) for _, placement, level_db, _ in played(pipeline_of(rig), rig.recording)]
    if expected and expected[-1] != (None, None):
        expected.append((None, None))  # a run that ends falls silent, whatever rests
    assert [(change.placement, change.level_db) for change in rig.run().trace] == expected


HERE = Placement((0.05, 0.15), (True, False))
DRIVE = DriveCommand(b"drive", 150.0)


def held_after(command: Command | None) -> HeldDrive:
    held = HeldDrive()
    held.note(HERE, command)
    return held


def test_the_same_fingers_keep_their_frequency_while_they_move() -> None:
    held = held_after(DRIVE)
    near, far = (Placement((0.05, 0.15 + factor * SAME_FINGER_M), HERE.is_felt) for factor in (0.9, 1.1))
    assert held.frequency_for(HERE) == held.frequency_for(near) == 150.0
    assert held.frequency_for(far) is None


@pytest.mark.parametrize("others", [None, Placement((0.05,), (True,)), Placement(HERE.position_m, (False, True))])
def test_other_fingers_have_no_frequency(others: Placement | None) -> None:
    assert held_after(DRIVE).frequency_for(others) is None


@pytest.mark.parametrize("command", [SILENCE, None, DriveCommand(b"several frequencies")])
def test_what_has_no_frequency_ends_it(command: Command | None) -> None:
    assert held_after(command).frequency_for(HERE) is None
