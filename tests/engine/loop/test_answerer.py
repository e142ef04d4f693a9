"""The frequency that fingers have: kept while the same fingers move, and forgotten with the drive."""

import pytest

from engine.loop.answerer import SAME_FINGER_M, HeldDrive
from engine.render.renderer import SILENCE, Command, DriveCommand
from engine.touch import Placement

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
