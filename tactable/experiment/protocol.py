"""An experiment's protocol: a TOML file to tasks, each with its fingers, its stimuli and its numbers of trials."""

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from base.errors import TactableError
from base.files import shipped
from base.points import order_of, point_text
from engine.device import Device
from engine.device.toml_table import HIGHEST_LEVEL_DB, TomlTable, read_text
from engine.effects.rules import LOWEST_LEVEL_DB
from engine.touch import Placement

_MOST_TRIALS, _MOST_TASKS, _MOST_LEVELS = 1000, 32, 200
_LEAST_DIFFERENCE_DB = 0.1


class ExperimentError(TactableError, ValueError):
    """A protocol, its files or its engine cannot be used as asked; the message names the place and the remedy."""


class Kind(StrEnum):
    """What a trial asks."""

    DETECTION = "detection"  # two intervals, one with the stimulus: in which was it?
    MASKED = "masked"  # the same beneath a click at the other finger, which comes first in both intervals
    DISCRIMINATION = "discrimination"  # two intervals with stimuli of two levels: in which was the stronger?
    WHICH_FINGER = "which-finger"  # one stimulus at one of two fingers: at which?
    FELT_AND_QUIET = "felt-and-quiet"  # the same at one level, with four answers: left, right, both or none

    @property
    def has_intervals(self) -> bool:
        """Whether the answer is one of two intervals; else it is a finger."""
        return self in (Kind.DETECTION, Kind.MASKED, Kind.DISCRIMINATION)


@dataclass(frozen=True)
class Task:
    """A block of trials with the same fingers, stimulus and question.

    position_m: where the fingers rest, rising along the surface. levels_db: what may be asked for, dB above the
    device's threshold; of a discrimination the differences from `base_db`. base_db: the level of a discrimination, of
    the masking click, or of felt-and-quiet; None for the other kinds. gap_s: from the masking click to the one that is
    asked about. trials: for each finger. catch: trials without the stimulus.
    """

    name: str
    kind: Kind
    position_m: tuple[complex, ...]
    stimulus: str
    duration_s: float
    levels_db: tuple[float, ...]
    base_db: float | None
    gap_s: float
    trials: int
    practice: int
    catch: int

    @property
    def choices(self) -> tuple[str, ...]:
        """The answers, the right one of a trial at its `side`."""
        if self.kind.has_intervals:
            return "first", "second"
        return ("left", "right", "both", "none")[: 2 if self.kind is Kind.WHICH_FINGER else 4]

    @property
    def question(self) -> str:
        """What is asked after the stimuli; {finger} stands for the finger that a trial is about."""
        return {
            Kind.DETECTION: "In which of the two did {finger} feel something?",
            Kind.MASKED: "In which of the two did {finger} feel something?",
            Kind.DISCRIMINATION: "Which of the two felt stronger under {finger}?",
            Kind.WHICH_FINGER: "Which finger felt it?",
            Kind.FELT_AND_QUIET: "Which finger felt it: left, right, both, or none?",
        }[self.kind]

    def finger_name(self, finger: int) -> str:
        """How the page calls a finger."""
        return "your finger" if len(self.position_m) == 1 else f"your {('left', 'right')[finger]} finger"

    @property
    def places_text(self) -> str:
        """Where the fingers rest, in words."""
        return " and ".join(map(point_text, self.position_m))

    def placement(self, felt: int) -> Placement:
        """The fingers, of which one feels."""
        return Placement(self.position_m, tuple(finger == felt for finger in range(len(self.position_m))))


@dataclass(frozen=True)
class Protocol:
    """Tasks, in the order of the file or, where `is_shuffled`, in one that the seed draws for each participant.

    has_markers: whether trials are told over the Lab Streaming Layer.
    """

    name: str
    title: str
    seed: int
    is_shuffled: bool
    tasks: tuple[Task, ...]
    has_markers: bool = False


class _ProtocolTable(TomlTable):
    family = ExperimentError

    def db(self, key: str, value: object, least: float, most: float) -> float:
        """A level or a difference that was taken, such as "-6 dB"."""
        match = re.fullmatch(r"([+-]?[0-9]+(?:\.[0-9]*)?) ?dB", value) if isinstance(value, str) else None
        if match is None or not least <= float(match[1]) <= most:
            raise self.error(key, value, f"expected {least:g} to {most:g} dB, such as '6 dB'")
        return float(match[1])


def protocol_names() -> list[str]:
    """Names of the shipped protocols."""
    return sorted(path.stem for path in shipped(Path(__file__).parents[1], "experiments").glob("*.toml"))


def read_protocol(name_or_path: str, device: Device) -> Protocol:
    """Read a protocol for the surface of a device, by file path or by shipped name.

    Raises ExperimentError for a file that is none, and PlacementError for fingers that the surface does not tell apart.
    """
    path = Path(name_or_path)
    if name_or_path in protocol_names() and not path.is_file():
        path = shipped(Path(__file__).parents[1], "experiments") / f"{name_or_path}.toml"
    try:
        text = read_text(path, ExperimentError)
    except OSError as error:
        known = ", ".join(protocol_names())
        raise ExperimentError(
            f"{path}: no protocol can be read there ({error.strerror}); shipped are {known}"
        ) from None
    return parse_protocol(text, str(path), device)


def parse_protocol(text: str, source: str, device: Device) -> Protocol:
    """As `read_protocol`, of a text that `source` names in errors."""
    part = _ProtocolTable.parse(text, source)
    name = part.name("name")
    tables = part.tables("task")
    if len(tables) > _MOST_TASKS:
        raise part.error("task", len(tables), f"expected at most {_MOST_TASKS} tasks")
    found = Protocol(
        name,
        part.sentence("title") or name,
        part.integer("seed", 0, 1 << 31, 0),
        part.word("order", ("stated", "shuffled"), "stated") == "shuffled",
        tuple(_task_of(each, device) for each in tables),
        part.word("markers", ("none", "lsl"), "none") == "lsl",
    )
    part.refuse_rest()
    names = [task.name for task in found.tasks]
    for each in names:
        if names.count(each) > 1:
            raise part.error("task", each, "two tasks have this name: give each its own")
    return found


def _task_of(part: _ProtocolTable, device: Device) -> Task:
    name, kind = part.name("name"), Kind(part.word("kind", tuple(Kind)))
    stimulus = part.word("stimulus", ("click", "tone"), "click")
    if kind is Kind.MASKED and stimulus == "tone":
        raise part.error("stimulus", stimulus, "a masked task is of clicks: a tone would end the click before it")
    places = part.take_value("fingers")
    fewest = 1 if kind in (Kind.DETECTION, Kind.DISCRIMINATION) else 2
    if not isinstance(places, list) or not fewest <= len(places) <= 2:
        raise part.error(
            "fingers", places, f"expected {'one or two places' if fewest == 1 else 'two places'}: ['35 mm']"
        )
    found_m = sorted((part.checked_point("fingers", each, device.surface.corner_m) for each in places), key=order_of)
    Placement.on(device, found_m)  # it refuses fingers that lie too close
    base_db = None
    if kind not in (Kind.DETECTION, Kind.WHICH_FINGER):
        base_db = part.db("base", part.take_value("base"), LOWEST_LEVEL_DB, HIGHEST_LEVEL_DB)
    task = Task(
        name,
        kind,
        tuple(found_m),
        stimulus,
        part.quantity("duration", "s", least=0.05, default="0.5 s") if stimulus == "tone" else 0.0,
        () if kind is Kind.FELT_AND_QUIET else _levels_of(part, kind, base_db or 0.0),
        base_db,
        part.quantity("gap", "s", least=0.03, default="0.1 s") if kind is Kind.MASKED else 0.0,
        part.integer("trials", 1, _MOST_TRIALS),
        part.integer("practice", 0, _MOST_TRIALS, 4),
        part.integer("catch", 0, _MOST_TRIALS, 4),
    )
    part.refuse_rest()
    return task


def _levels_of(part: _ProtocolTable, kind: Kind, base_db: float) -> tuple[float, ...]:
    """The grid of levels, or of the differences of a discrimination."""
    ends = part.take_value("levels")
    least, most = LOWEST_LEVEL_DB, HIGHEST_LEVEL_DB
    if kind is Kind.DISCRIMINATION:
        least, most = _LEAST_DIFFERENCE_DB, HIGHEST_LEVEL_DB - base_db
    step_db = part.db("step", part.take_value("step", "1 dB"), 0.1, HIGHEST_LEVEL_DB)
    if not isinstance(ends, list) or len(ends) != 2:
        raise part.error("levels", ends, "expected the lowest and the highest, such as ['-8 dB', '24 dB']")
    low_db, high_db = (part.db("levels", end, least, most) for end in ends)
    count = round((high_db - low_db) / step_db) + 1
    if not 3 <= count <= _MOST_LEVELS:
        raise part.error("levels", ends, f"expected 3 to {_MOST_LEVELS} levels {step_db:g} dB apart, the lowest first")
    return tuple(np.round(low_db + step_db * np.arange(count), 6).tolist())
