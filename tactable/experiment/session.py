"""A session: a protocol and the answers so far to the next trial. It has no clock, plays nothing, and can be replayed.

Theory of operation
-------------------
Protocol, participant and seed give the *slots*: for every task its practice, then its test and catch trials in drawn
order, each with the finger that it is about and the side of the right answer. Sides are counterbalanced for each
finger. A slot has no level; that comes from the answers: every *track* (the trials of a task about one finger, of
which-finger all of them) is one `QuestPlus`. So a session is resumed by giving it the trials of its file again.
"""

import math
import random
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from tactable.experiment.protocol import ExperimentError, Kind, Protocol, Task
from tactable.experiment.quest_plus import QuestPlus


class Role(StrEnum):
    """What a trial is for."""

    PRACTICE = "practice"  # strong, and the page says whether the answer was right
    TEST = "test"
    CATCH = "catch"  # without the stimulus that is asked about: what is answered then is a guess


class Trial(NamedTuple):
    """One trial. level_db: as Task.levels_db, None for a catch trial; side: index of the right answer."""

    number: int
    task: Task
    role: Role
    finger: int
    side: int
    level_db: float | None


class Stimulus(NamedTuple):
    """A click or a tone at one of a task's fingers, `after_s` the beginning of its interval."""

    finger: int
    level_db: float
    after_s: float = 0.0


def stimulus_axis(task: Task, level_db: float) -> float:
    """The psychometric function's argument for a level, in dB.

    A level is its own argument. The difference of a discrimination is one on a logarithmic scale, 20 log10, since it
    is always above 0.
    """
    return 20 * math.log10(level_db) if task.kind is Kind.DISCRIMINATION else level_db


def track_of(task: Task, finger: int) -> tuple[str, int]:
    """The adaptive track of a trial: by task and finger, and one for all of which-finger, whose answers are fingers."""
    return task.name, 0 if task.kind is Kind.WHICH_FINGER else finger


def stimuli_of(trial: Trial) -> list[list[Stimulus]]:
    """What each interval of a trial plays, in order."""
    task, finger, level_db = trial.task, trial.finger, trial.level_db
    base_db = 0.0 if task.base_db is None else task.base_db
    if not task.kind.has_intervals:
        return [[] if level_db is None else [Stimulus(finger, level_db)]]
    intervals: list[list[Stimulus]] = [[], []]
    if task.kind is Kind.DISCRIMINATION:
        intervals = [[Stimulus(finger, base_db + (level_db or 0.0) * (side == trial.side))] for side in range(2)]
    else:
        if task.kind is Kind.MASKED:
            intervals = [[Stimulus(1 - finger, base_db)] for _ in range(2)]
        if level_db is not None:
            intervals[trial.side].append(Stimulus(finger, level_db, task.gap_s))
    return intervals


class Session:
    """The trials of one participant, from `next_trial` to `record`, one after another."""

    def __init__(self, protocol: Protocol, participant: str) -> None:
        drawn = random.Random(f"{protocol.seed} {participant}")
        tasks = list(protocol.tasks)
        if protocol.is_shuffled:
            drawn.shuffle(tasks)
        slots = [slot for task in tasks for slot in _slots_of(task, drawn)]
        self._slots = [slot._replace(number=number) for number, slot in enumerate(slots)]  # trials without their level
        self._tracks: dict[tuple[str, int], QuestPlus] = {}
        self.done = 0

    @property
    def total(self) -> int:
        """Number of all trials."""
        return len(self._slots)

    def next_trial(self) -> Trial | None:
        """The trial that is due; None: all are done."""
        if self.done == len(self._slots):
            return None
        slot = self._slots[self.done]
        task, level_db = slot.task, slot.task.base_db
        if slot.role is Role.CATCH:
            level_db = None
        elif task.levels_db:
            level_db = task.levels_db[-1]
            if slot.role is Role.TEST:
                track = self._track(slot)
                level_db = task.levels_db[int(np.argmin(abs(track.x_db - track.choose_stimulus())))]
        return slot._replace(level_db=level_db)

    def record(self, trial: Trial, answer: int) -> bool:
        """Take the answer to the trial that is due; whether it was right. Of a catch trial of fingers none is right."""
        slot = self._slots[self.done]
        if trial[1:5] != slot[1:5]:
            raise ExperimentError(
                f"trial {trial.number + 1} is not trial {self.done + 1} of this protocol and participant: the file "
                "belongs to another protocol; choose another --output or --participant"
            )
        self.done += 1
        is_right = answer == (len(trial.task.choices) - 1 if is_empty(trial) else trial.side)
        if slot.role is Role.TEST and trial.task.levels_db and trial.level_db is not None:
            self._track(slot).update(stimulus_axis(trial.task, trial.level_db), is_right)
        return is_right

    def _track(self, slot: Trial) -> QuestPlus:
        key = track_of(slot.task, slot.finger)
        if key not in self._tracks:
            self._tracks[key] = QuestPlus(np.array([stimulus_axis(slot.task, each) for each in slot.task.levels_db]))
        return self._tracks[key]


def is_empty(trial: Trial) -> bool:
    """Whether no finger feels anything, and "none" is the right answer."""
    return trial.role is Role.CATCH and trial.task.kind is Kind.FELT_AND_QUIET


def _slots_of(task: Task, drawn: random.Random) -> list[Trial]:
    """Practice, then test and catch trials in drawn order, not numbered and without levels."""
    fingers = range(len(task.position_m))

    def balanced(role: Role, count: int, about: Sequence[int]) -> list[Trial]:
        """`count` trials, fingers and sides as even as it goes."""
        pairs = [(finger, side) for side in range(2) for finger in about]
        if not task.kind.has_intervals:
            pairs = [(finger, finger) for finger in about]
        first = drawn.randrange(len(pairs))  # so that odd numbers prefer no side over participants
        return [Trial(0, task, role, *pairs[(first + k) % len(pairs)], None) for k in range(count)]

    tests = [slot for finger in fingers for slot in balanced(Role.TEST, task.trials, [finger])]
    mixed = tests + balanced(Role.CATCH, task.catch, fingers)
    practice = balanced(Role.PRACTICE, task.practice, fingers)
    drawn.shuffle(mixed)
    drawn.shuffle(practice)
    return practice + mixed
