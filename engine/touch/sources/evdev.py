"""A touch device of Linux's input layer to reports: multitouch protocol B, for what hidraw does not reach.

The package `evdev` finds and opens; it is an optional extra and handed in.
"""

import fcntl
import importlib
import struct
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

from engine.touch.digitizer import Contact, DigitizerError
from engine.touch.sources import OnClock
from engine.touch.sources.own_reports import MOST_CONTACTS, Axis, ContactReports

# linux/input-event-codes.h
EV_SYN, EV_ABS = 0x00, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3  # of type EV_SYN
SLOT, _X, _Y, _TOOL_TYPE, TRACKING_ID, _DISTANCE = 0x2F, 0x35, 0x36, 0x37, 0x39, 0x3B  # ABS_MT_..., of type EV_ABS
_SLOT_CODES = (_X, _Y, TRACKING_ID, _DISTANCE, _TOOL_TYPE)
_OPTIONAL = (_DISTANCE, _TOOL_TYPE)
SLOT_AXES = frozenset((SLOT, _X, _Y, TRACKING_ID))  # of a node that reports contacts in slots, protocol B
_PALM = 2  # MT_TOOL_PALM
_NOBODY = -1


class InputEvent(Protocol):
    """An event of the input layer."""

    @property
    def type(self) -> int:
        """EV_SYN, EV_ABS and others."""

    @property
    def code(self) -> int:
        """Code of the axis, or of the kind of synchronisation."""

    @property
    def value(self) -> int:
        """The new value."""


class InputNode(Protocol):
    """The part of `evdev.InputDevice` that is used."""

    path: str
    fd: int
    name: str

    def read(self) -> Iterable[InputEvent]:
        """Up to 64 available events; raises BlockingIOError for none, OSError once the device is gone."""

    def absinfo(self, axis_num: int) -> Any:
        """Range (`min`, `max`), `resolution` per millimetre and `value` of an axis."""

    def capabilities(self) -> dict[int, list[Any]]:
        """Codes by event type; those of axes as pairs with their ranges."""

    def close(self) -> None:
        """Give the device back."""


class EvdevModule(Protocol):
    """The part of the package `evdev` that is used."""

    def list_devices(self) -> list[str]:
        """Paths of the nodes that may be opened."""

    def InputDevice(self, dev: str) -> InputNode:  # noqa: N802  # the package's name
        """Open a node."""


ReadSlots = Callable[[int, int, int], Sequence[int]]  # descriptor, axis code, number of slots: the values by slot


def load_evdev(import_module: Callable[[str], object] = importlib.import_module) -> EvdevModule | None:
    """The Python package evdev, or None on a system where it is not installed."""
    try:
        return cast(EvdevModule, import_module("evdev"))
    except ImportError:
        return None


def read_slots(descriptor: int, code: int, slots: int) -> Sequence[int]:
    """EVIOCGMTSLOTS: the kernel's own state of an axis, which is right whatever events were lost."""
    form = f"I{slots}i"
    buffer = bytearray(struct.pack(form, code, *[0] * slots))
    fcntl.ioctl(descriptor, 0x8000450A | len(buffer) << 16, buffer)
    return struct.unpack(form, buffer)[1:]


@dataclass(frozen=True)
class EvdevDigitizer:
    """One multitouch node that may be opened; `stable_id` is its link in /dev/input/by-id or by-path, else its path."""

    path: str
    name: str
    stable_id: str


def find_evdev_digitizers(evdev: EvdevModule, links: Path = Path("/dev/input")) -> tuple[EvdevDigitizer, ...]:
    """Every multitouch node of protocol B this user may open, in the order of its path."""
    names = {
        str(link.resolve()): str(link)
        for folder in ("by-path", "by-id")
        if (links / folder).is_dir()
        for link in sorted((links / folder).iterdir())
    }
    found = []
    for path in sorted(evdev.list_devices()):
        try:
            node = evdev.InputDevice(path)
        except OSError:
            continue  # unplugged meanwhile
        if _has_slots(node):
            found.append(EvdevDigitizer(path, node.name, names.get(path, path)))
        node.close()
    return tuple(found)


def _has_slots(node: InputNode) -> bool:
    return _axis_codes(node) >= SLOT_AXES


def _axis_codes(node: InputNode) -> set[int]:
    return {code for code, _ in node.capabilities().get(EV_ABS, [])}


class SlotTracker:
    """Turns events of protocol B into the contacts at each SYN_REPORT; a lifted contact comes once, without tip."""

    def __init__(self, slots: int) -> None:
        self._values = {code: [0] * slots for code in _SLOT_CODES}
        self._values[TRACKING_ID] = [_NOBODY] * slots
        self._slot = 0
        self._shown: dict[int, Contact] = {}

    def set_axis(self, code: int, value: int) -> None:
        """An EV_ABS event."""
        if code == SLOT:
            self._slot = value
        elif code in self._values and 0 <= self._slot < len(self._values[code]):
            self._values[code][self._slot] = value

    def set_slots(self, slot: int, values: dict[int, Sequence[int]]) -> None:
        """The kernel's state: the slot that the next events are for, and each axis by its code."""
        self._slot = slot
        for code, slots in values.items():
            self._values[code] = list(slots)

    def take_frame(self) -> tuple[Contact, ...]:
        """Contacts of a SYN_REPORT, lifted ones first; empty when nothing is down and nothing was."""
        values = self._values
        rows = zip(*(values[code] for code in _SLOT_CODES), strict=True)
        down = {
            contact_id: Contact(contact_id, x, y, tip=True, confidence=tool != _PALM)
            for x, y, contact_id, distance, tool in rows
            if contact_id != _NOBODY and distance <= 0
        }
        lifted = [contact._replace(tip=False) for contact_id, contact in self._shown.items() if contact_id not in down]
        self._shown = down
        return (*lifted, *down.values())

    def lift_all(self) -> tuple[Contact, ...]:
        """Contacts of a device that is gone."""
        self._values[TRACKING_ID] = [_NOBODY] * len(self._values[TRACKING_ID])
        return self.take_frame()


class EvdevSource(OnClock):
    """A multitouch node as a Source; an unplug releases everything and ends it.

    Its vendor and product are 0: its reports are of our own making, and the quirks of the device do not hold for them.
    A release the kernel owes (100 ms) is trusted. Raises `DigitizerError` for a node without slots.
    """

    def __init__(self, node: InputNode, read_slots: ReadSlots = read_slots) -> None:
        if not _has_slots(node):
            raise DigitizerError(f"{node.path} ({node.name}) has no multitouch slots: choose its hidraw node")
        slots = node.absinfo(SLOT).max + 1
        self.name = node.name
        self._node = node
        self._is_open = True
        self._read_slots = read_slots
        self._tracker = SlotTracker(slots)
        # A frame may lift every finger and put down as many.
        most = min(max(2, 2 * slots), MOST_CONTACTS)
        self._encoder = ContactReports(_axis(node, _X), _axis(node, _Y), contacts=most, maximum_contacts=most)
        self.descriptor = self._encoder.descriptor
        self.slots = slots  # how many fingers the device tells apart
        axes = _axis_codes(node)
        self._codes = [code for code in _SLOT_CODES if code in axes or code not in _OPTIONAL]
        self._is_dropping = False
        self._ready: deque[bytes] = deque()
        self._read_slot_state()
        self._take_frame()

    @property
    def ended(self) -> bool:
        """The device is gone and what it held is released."""
        return not self._is_open and not self._ready

    def fileno(self) -> int | None:
        """The node."""
        return self._node.fd if self._is_open else None

    def next_time_ns(self) -> int | None:
        """Now for reports that were read already."""
        return 0 if self._ready else None

    def read(self, now_ns: int) -> bytes | None:
        """The next frame as a report."""
        if not self._ready and self._is_open:
            self._read_node()
        if not self._ready:
            return None
        self.report_index += 1
        self.report_time_ns = now_ns
        return self._ready.popleft()

    def close(self) -> None:
        """Give the node back."""
        self._is_open = False
        self._ready.clear()
        self._node.close()

    def _read_node(self) -> None:
        try:
            for event in self._node.read():
                self._take_event(event)
        except BlockingIOError:
            pass
        except OSError:
            self._is_open = False
            self._queue(self._tracker.lift_all())

    def _take_event(self, event: InputEvent) -> None:
        """After SYN_DROPPED everything up to the next SYN_REPORT is void, and the kernel is asked instead."""
        if event.type == EV_SYN and event.code == SYN_DROPPED:
            self._is_dropping = True
        elif event.type == EV_SYN and event.code == SYN_REPORT:
            if self._is_dropping:
                self._is_dropping = False
                self._read_slot_state()
            self._take_frame()
        elif event.type == EV_ABS and not self._is_dropping:
            self._tracker.set_axis(event.code, event.value)

    def _read_slot_state(self) -> None:
        values = {code: self._read_slots(self._node.fd, code, self.slots) for code in self._codes}
        self._tracker.set_slots(self._node.absinfo(SLOT).value, values)

    def _take_frame(self) -> None:
        self._queue(self._tracker.take_frame())

    def _queue(self, contacts: Sequence[Contact]) -> None:
        if contacts:
            self._ready.append(self._encoder.encode(contacts))


def open_evdev(path: str, evdev: EvdevModule | None) -> EvdevSource:
    """Open a multitouch node. Raises `DigitizerError`."""
    if evdev is None:
        raise DigitizerError(f"{path} needs the package evdev: run `pip install tactable[evdev]`")
    try:
        node = evdev.InputDevice(path)
    except PermissionError as error:
        raise DigitizerError(f"no permission to read {path}: add this user to group `input`, then log in") from error
    except OSError as error:
        raise DigitizerError(f"cannot open {path}: {error}; `tactable list` shows what there is") from error
    try:
        return EvdevSource(node)
    except BaseException:
        node.close()
        raise


def _axis(node: InputNode, code: int) -> Axis:
    info = node.absinfo(code)
    return Axis(info.min, info.max, (info.max - info.min) / info.resolution if info.resolution > 0 else None)
