"""Reads recordings of Linux's input layer, by evemu-record and `libinput record`, as reports.

Their events go through `EvdevSource`, as those of a live node do. Where `libinput record --with-hidraw` kept the
reports of a touch surface, these are read instead: they are what the device sent.
"""

import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from base.errors import TactableError
from engine.touch.digitizer import open_digitizer
from engine.touch.sources.evdev import EV_ABS, EV_SYN, SLOT, SYN_DROPPED, SYN_REPORT, TRACKING_ID, EvdevSource
from engine.touch.sources.recording import Recording, RecordingError, Report

# `key: [numbers]` at the start of a line, also over several lines; an event has no key.
_NUMBERS = re.compile(r"^(?:- )*(?:(\w+): *)?\[([^][]*)\]", re.MULTILINE)
_NODE, _NAME = re.compile(r"^- node:", re.MULTILINE), re.compile(r"^name:(.*)$", re.MULTILINE)
_COMMENT = re.compile(r"(?:^|(?<=[ \t]))#.*$", re.MULTILINE)
_TIME = re.compile(r"[0-9]{1,12}\.[0-9]{1,6}")
_MOST_SLOTS, _WIDEST = 256, 10_000_000  # more than any panel: a greater range is a slip, and fits no report
_REMEDY = "record its hidraw node, with hid-recorder or tactable"


class _Range(NamedTuple):
    min: int
    max: int
    resolution: int
    value: int = 0


class _Event(NamedTuple):
    time_s: float
    type: int
    code: int
    value: int


@dataclass
class _Node:
    """A recorded node as an InputNode; each read gives the events of one SYN_REPORT."""

    path: str
    name: str = ""
    identity: tuple[int, ...] = (0, 0, 0)
    axes: dict[int, _Range] = field(default_factory=dict)
    events: deque[_Event] = field(default_factory=deque)
    descriptor: bytes = b""
    reports: list[Report] = field(default_factory=list)  # those of its hidraw node
    fd: int = -1
    time_s: float = 0.0

    def read(self) -> Iterator[_Event]:
        """The next events; what was lost at a SYN_DROPPED is not in the file."""
        while self.events:
            event = self.events.popleft()
            self.time_s = event.time_s
            if event[1:3] != (EV_SYN, SYN_DROPPED):
                yield event
            if event[1:3] == (EV_SYN, SYN_REPORT):
                return

    def absinfo(self, axis_num: int) -> Any:
        """Range of an axis."""
        return self.axes[axis_num]

    def capabilities(self) -> dict[int, list[Any]]:
        """The axes."""
        return {EV_ABS: list(self.axes.items())}

    def close(self) -> None:
        """Nothing is open."""

    def set_range(self, code: int, numbers: list[int]) -> None:
        """Minimum, maximum, fuzz, flat and, not in all files, resolution. Raises ValueError."""
        least, most, _, _, resolution = (*numbers, 0)[:5]
        if not (0 <= most - least <= _WIDEST and least >= -_WIDEST and resolution >= 0):
            raise ValueError(f"range {least} to {most}")
        if code == SLOT and most >= _MOST_SLOTS:
            raise ValueError(f"{most + 1} slots")
        self.axes[code] = _Range(least, most, resolution)

    def recording(self) -> Recording:
        """Its reports where they are those of a touch surface, else its events as ours. Raises TactableError."""
        bus, vendor_id, product_id, *_ = self.identity
        if self.reports:
            try:
                open_digitizer(self.descriptor, vendor_id, product_id)
                return Recording(self.name, bus, vendor_id, product_id, self.descriptor, tuple(self.reports))
            except TactableError:
                pass  # of another interface of the device
        source = EvdevSource(self, lambda _, code, slots: [-1 if code == TRACKING_ID else 0] * slots)
        reports = list[Report]()
        while self.events:
            data = source.read(0)
            if data is not None:
                reports.append(Report(len(reports), self.time_s, data))
        return Recording(self.name, 0, 0, 0, source.descriptor, tuple(reports))


def read_evemu(path: Path, text: str) -> Recording:
    """A recording by evemu-record, whose lines may be quoted. Raises RecordingError."""
    node = _Node(str(path))
    for number, line in enumerate(text.split("\n"), 1):
        key, _, value = line.partition("#")[0].partition(":")
        words = value.split()
        try:
            if key == "N":
                node.name = line.partition(":")[2].strip()
            elif key == "I":
                node.identity = (*(int(word, 16) for word in words), 0, 0, 0)[:3]
            elif key == "A":
                node.set_range(int(words[0], 16), [int(word) for word in words[1:]])
            elif key == "E":
                if not _TIME.fullmatch(words[0]):
                    raise ValueError("no time")
                node.events.append(_Event(float(words[0]), int(words[1], 16), int(words[2], 16), int(words[3])))
        except (ValueError, IndexError) as error:
            problem = f"{key}: {value.strip()[:40]!r} ({error})"
            raise RecordingError(path, number, problem, "the line is cut off or edited: record again") from None
    return _recording_of(path, [(1, node)])


def read_libinput(path: Path, text: str) -> Recording:
    """The first touch surface of a recording by `libinput record`. Raises RecordingError."""
    text = _COMMENT.sub("", text)
    starts = [found.start() for found in _NODE.finditer(text)]
    nodes = []
    for start, stop in pairwise([*starts, len(text)]):
        part, before = text[start:stop], text.count("\n", 0, start)
        node, name = _Node(str(path)), _NAME.search(part)
        node.name = "" if name is None else name[1].strip(' \t"')
        for found in _NUMBERS.finditer(part):
            try:
                _take_numbers(node, found[1], [int(word, 0) for word in found[2].split(",") if word.strip()])
            except (ValueError, OverflowError) as error:
                number = before + part.count("\n", 0, found.start()) + 1
                problem = f"{found[0].strip()[:40]!r} ({error})"
                raise RecordingError(path, number, problem, "the line is cut off or edited: record again") from None
        nodes.append((before + 1, node))
    return _recording_of(path, nodes)


def _take_numbers(node: _Node, key: str | None, numbers: list[int]) -> None:
    """Take a list of a libinput file into the node. Raises ValueError."""
    if key is None or key == "time":
        seconds, microseconds, *event = numbers
        node.time_s = seconds + microseconds / 1e6
        if key is None:
            kind, code, value = event
            node.events.append(_Event(node.time_s, kind, code, value))
    elif key == "id":
        node.identity = (*numbers, 0, 0, 0)[:3]
    elif key == "hid":
        node.descriptor = bytes(numbers)
    elif key.startswith("hidraw"):
        # Versions before `time:` leave the last event's.
        node.reports.append(Report(len(node.reports), node.time_s, bytes(numbers)))
    elif key.isdecimal() and int(key) >= SLOT and len(numbers) == 5:  # in `codes:` the keys are types, all below it
        node.set_range(int(key), numbers)


def _recording_of(path: Path, nodes: list[tuple[int, _Node]]) -> Recording:
    """The recording of the first node that is a touch surface; nodes come with their lines."""
    for _, node in nodes:
        try:
            return node.recording()
        except TactableError:
            continue
    number, name = (nodes[0][0], nodes[0][1].name) if nodes else (1, "the file")
    problem = f"{name} states no multitouch slots (ABS_MT_SLOT, POSITION_X and Y, TRACKING_ID)"
    raise RecordingError(path, number, problem, _REMEDY)
