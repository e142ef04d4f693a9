"""Laws of the input layer's multitouch protocol B as a source."""

import errno
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device
from engine.touch import Digitizer, DigitizerError, TouchFrame, open_digitizer
from engine.touch.debounce import fit_releases
from engine.touch.sources import Source
from engine.touch.sources.evdev import EvdevSource, find_evdev_digitizers, load_evdev, open_evdev
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
MS = 1_000_000
EV_SYN, EV_ABS = 0, 3
SYN_REPORT, SYN_DROPPED = 0, 3
SLOT, X, Y, TRACKING_ID, DISTANCE = 0x2F, 0x35, 0x36, 0x39, 0x3B
SLOTS = 5
Touch = tuple[int, int]
"""X and distance of a finger."""


class Event(NamedTuple):
    type: int
    code: int
    value: int


class AbsInfo(NamedTuple):
    value: int
    min: int
    max: int
    resolution: int


@dataclass
class FakeKernel:
    """The input layer and its node: a state by slot, of which it tells changes only, and a buffer that overflows."""

    path: str = "/dev/input/event3"
    fd: int = 42
    name: str = "ELAN Touchscreen"
    axes: tuple[int, ...] = (SLOT, X, Y, TRACKING_ID, DISTANCE)
    buffer_size: int = 1000
    is_there: bool = True
    is_closed: bool = False
    events: deque[Event] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self.state = {code: [0] * SLOTS for code in (X, Y, DISTANCE)} | {TRACKING_ID: [-1] * SLOTS}
        self.slot = 0

    def capabilities(self) -> dict[int, list[tuple[int, AbsInfo]]]:
        return {EV_SYN: [], EV_ABS: [(code, self.absinfo(code)) for code in self.axes]}

    def absinfo(self, axis_num: int) -> AbsInfo:
        if axis_num == SLOT:
            return AbsInfo(self.slot, 0, SLOTS - 1, 0)
        return AbsInfo(0, -100, 1900, 10) if axis_num == X else AbsInfo(0, 0, 1000, 0)

    def close(self) -> None:
        self.is_closed = True

    def read(self) -> Iterable[Event]:
        if not self.is_there:
            raise OSError(errno.ENODEV, "No such device")
        if not self.events:
            raise BlockingIOError
        return [self.events.popleft() for _ in range(min(64, len(self.events)))]

    def read_slots(self, descriptor: int, code: int, slots: int) -> Sequence[int]:
        assert (descriptor, slots) == (self.fd, SLOTS)
        return tuple(self.state[code])

    def show(self, touches: dict[int, tuple[int, Touch]]) -> None:
        """Slot to tracking id and touch, as the driver sees it at one moment."""
        for slot in range(SLOTS):
            tracking_id, (x, distance) = touches.get(slot, (-1, (self.state[X][slot], 0)))
            for code, value in ((TRACKING_ID, tracking_id), (X, x), (DISTANCE, distance)):
                self._set(slot, code, value)
        self._emit(Event(EV_SYN, SYN_REPORT, 0))

    def _set(self, slot: int, code: int, value: int) -> None:
        if self.state[code][slot] == value:
            return
        if self.slot != slot:
            self.slot = slot
            self._emit(Event(EV_ABS, SLOT, slot))
        self.state[code][slot] = value
        self._emit(Event(EV_ABS, code, value))

    def _emit(self, event: Event) -> None:
        """As evdev_pass_event: a full buffer is thrown away for SYN_DROPPED and the event that did not fit."""
        if len(self.events) >= self.buffer_size:
            self.events.clear()
            self.events.append(Event(EV_SYN, SYN_DROPPED, 0))
        self.events.append(event)


def opened(kernel: FakeKernel) -> EvdevSource:
    return EvdevSource(kernel, read_slots=kernel.read_slots)


def frames(source: Source, now_ns: int = 0, digitizer: Digitizer | None = None) -> list[TouchFrame]:
    digitizer = digitizer or open_digitizer(source.descriptor, source.vendor_id, source.product_id)
    found = []
    while (report := source.read(now_ns)) is not None:
        frame = digitizer.decode_report(report, source.report_time_ns)
        assert frame is not None
        found.append(frame)
    return found


def places(frame: TouchFrame) -> dict[int, int]:
    assert all(contact.tip for contact in frame.contacts)
    return {contact.contact_id: contact.x for contact in frame.contacts}


def test_each_syn_report_is_a_frame_of_all_that_touches_and_of_what_touched_before() -> None:
    kernel = FakeKernel()
    kernel.show({2: (7, (300, 0))})
    kernel.events.clear()
    assert [places(frame) for frame in frames(opened(kernel))] == [{7: 300}]
    kernel = FakeKernel()
    source = opened(kernel)
    kernel.show({0: (10, (100, 0))})
    kernel.show({0: (10, (150, 0)), 3: (11, (-50, 0))})
    kernel.show({3: (11, (-50, 0))})
    kernel.show({})
    assert [places(frame) for frame in frames(source)] == [{10: 100}, {10: 150, 11: -50}, {11: -50}, {}]
    for x in range(10):
        kernel.show({0: (10, (x, 0))})
    assert source.read(0) is not None and source.next_time_ns() == 0  # more events than one read takes are due at once


touches = st.dictionaries(
    st.integers(0, SLOTS - 1), st.tuples(st.integers(-100, 1900), st.sampled_from([0, 0, 1])), max_size=SLOTS
)
moments = st.lists(st.tuples(touches, st.booleans(), st.booleans()), min_size=1, max_size=30)


@given(moments, st.integers(4, 60))
def test_after_any_loss_the_last_frame_is_the_kernels_state(
    shown: list[tuple[dict[int, Touch], bool, bool]], buffer_size: int
) -> None:
    kernel = FakeKernel(buffer_size=buffer_size)
    source = opened(kernel)
    digitizer = open_digitizer(source.descriptor)
    ids, now, last = list(range(1, SLOTS + 1)), dict[int, int](), dict[int, int]()
    for moment, is_read, renews in [*shown, ({}, False, False), (shown[-1][0], True, True)]:
        if renews:
            ids = [name + SLOTS for name in ids]
        kernel.show({slot: (ids[slot], touch) for slot, touch in moment.items()})
        now = {ids[slot]: x for slot, (x, distance) in moment.items() if distance == 0}
        for frame in frames(source, 0, digitizer) if is_read else []:
            last = places(frame)
    assert last == now


@pytest.mark.parametrize("device", [DEVICE, replace(DEVICE, touch_axis=replace(DEVICE.touch_axis, silence_s=0.12))])
def test_a_resting_finger_stays_for_the_kernel_tells_its_lift(device: Device) -> None:
    kernel = FakeKernel()
    source = opened(kernel)
    digitizer = open_digitizer(source.descriptor)
    fit_releases(digitizer, device)
    kernel.show({0: (10, (100, 0))})
    assert [places(frame) for frame in frames(source, 0, digitizer)] == [{10: 100}]
    assert (digitizer.due_ns, source.next_time_ns()) == (None, None)


def test_an_unplug_releases_everything_and_ends() -> None:
    kernel = FakeKernel()
    source = opened(kernel)
    kernel.show({0: (10, (100, 0))})
    digitizer = open_digitizer(source.descriptor)
    assert [places(frame) for frame in frames(source, 0, digitizer)] == [{10: 100}]
    kernel.is_there = False
    assert not source.ended
    assert [frame.contacts for frame in frames(source, MS, digitizer)] == [()]
    assert (source.ended, source.fileno(), source.read(2 * MS), source.next_time_ns()) == (True, None, None, None)


@dataclass
class FakeEvdev:
    """The package."""

    nodes: dict[str, FakeKernel]
    error: OSError | None = None

    def list_devices(self) -> list[str]:
        return [*self.nodes, "/dev/input/event99"]

    def InputDevice(self, dev: str) -> FakeKernel:  # noqa: N802  # the package's name
        if self.error is not None:
            raise self.error
        if dev not in self.nodes:
            raise FileNotFoundError(errno.ENOENT, "No such file", dev)
        return self.nodes[dev]


def test_only_multitouch_nodes_are_found_by_their_stable_links_and_others_are_given_back(tmp_path: Path) -> None:
    (tmp_path / "by-id").mkdir()
    link, node = tmp_path / "by-id" / "usb-ELAN-event", tmp_path / "event3"
    node.touch()
    link.symlink_to(node)
    mouse = FakeKernel("mouse", axes=(0, 1))
    evdev = FakeEvdev({str(node): FakeKernel(str(node)), "mouse": mouse})
    (found,) = find_evdev_digitizers(evdev, tmp_path)
    assert (found.path, found.stable_id, found.name) == (str(node), str(link), "ELAN Touchscreen")
    assert mouse.is_closed
    mouse.is_closed = False
    with pytest.raises(DigitizerError, match="no multitouch slots"):
        open_evdev("mouse", evdev)
    assert mouse.is_closed


@pytest.mark.parametrize(
    ("error", "remedy"),
    [(PermissionError(13, "Permission denied"), "group `input`"), (OSError(19, "No such device"), "tactable list")],
)
def test_a_node_that_cannot_be_opened_says_what_to_do(error: OSError, remedy: str) -> None:
    with pytest.raises(DigitizerError, match=remedy):
        open_evdev("/dev/input/event3", FakeEvdev({}, error))


def test_without_the_package_the_extra_is_named() -> None:
    def import_module(name: str) -> object:
        raise ImportError(name)

    assert load_evdev(import_module) is None
    with pytest.raises(DigitizerError, match=r"pip install tactable\[evdev\]"):
        open_evdev("/dev/input/event3", None)
