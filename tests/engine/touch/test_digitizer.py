"""Laws of frame assembly, on devices made up here and on recorded ones, and of the quirks of devices."""

import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from engine.touch import Contact, DescriptorError, Digitizer, DigitizerError, TouchFrame, open_digitizer, quirks
from engine.touch.descriptor import SurfaceKind
from engine.touch.digitizer import AGAIN, RELEASE_AFTER_NS
from engine.touch.sources import LIFT_ALL
from engine.touch.sources.recording import Recording, read_recording
from tests.engine.shared_recordings import RECORDINGS, recording_params
from tests.engine.test_fuzz import check_frame
from tests.engine.touch.descriptors import CERTIFIED, CONTACT_COUNT, HYBRID, PEN, SERIAL, TOUCH_PAD, application, finger

MS = 1_000_000


class Finger(NamedTuple):
    contact_id: int
    x: int = 100
    y: int = 200
    flags: int = 1

    def bytes(self) -> bytes:
        return bytes([self.flags, self.contact_id]) + self.x.to_bytes(2, "little") + self.y.to_bytes(2, "little")


UP = 0
NOBODY = Finger(0, 0, 0, UP)


def hybrid(first: Finger, second: Finger, count: int, scan_time: bytes = b"") -> bytes:
    return b"\x01" + first.bytes() + second.bytes() + scan_time + bytes([count])


def certified(first: Finger, second: Finger, ticks: int, count: int) -> bytes:
    return hybrid(first, second, count, ticks.to_bytes(2, "little"))


def ids(frame: TouchFrame | None) -> list[int] | None:
    return None if frame is None else [contact.contact_id for contact in frame.contacts]


def test_a_hybrid_frame_is_complete_with_its_last_report_and_silence_or_another_scan_time_starts_a_new_one() -> None:
    digitizer = open_digitizer(HYBRID)
    assert ids(digitizer.decode_report(hybrid(Finger(1), Finger(2), 1), 0)) == [1]  # a slot beyond the count is stale
    assert digitizer.decode_report(hybrid(Finger(1), Finger(2), 3), MS) is None
    assert digitizer.decode_report(hybrid(Finger(1), Finger(2), 3), 41 * MS) is None
    assert ids(digitizer.decode_report(hybrid(Finger(3), NOBODY, 0), 42 * MS)) == [1, 2, 3]
    assert digitizer.counters.lost_frames == 1
    digitizer = open_digitizer(CERTIFIED)
    digitizer.decode_report(certified(Finger(1), Finger(2), 10, 3), 0)
    assert ids(digitizer.decode_report(certified(Finger(1), Finger(2), 90, 2), 8 * MS)) == [1, 2]


def test_contacts_and_their_count_may_come_in_either_order() -> None:
    counts = bytes.fromhex("8503") + CONTACT_COUNT
    contacts = b"\x01" + Finger(1).bytes() + Finger(2).bytes()
    for reports in ([contacts, b"\x03\x01"], [b"\x03\x01", contacts]):
        digitizer = open_digitizer(application(finger(), finger(), counts))
        assert digitizer.decode_report(reports[0], 0) is None
        assert ids(digitizer.decode_report(reports[1], MS)) == [1]


def test_a_certified_device_hovers_and_others_do_not_repeats_a_contact_in_vain_and_tells_palms() -> None:
    hovering, repeated = Finger(1, flags=2), certified(Finger(1, x=10), Finger(1, x=20), 1, 1)
    for report, seen in ((certified(hovering, NOBODY, 1, 1), (100, False)), (repeated, (10, True))):
        frame = open_digitizer(CERTIFIED).decode_report(report, 0)
        assert frame is not None and [(contact.x, contact.tip) for contact in frame.contacts] == [seen]
    assert ids(open_digitizer(HYBRID).decode_report(hybrid(hovering, NOBODY, 1), 0)) == []
    for flags, confidence in ((3, True), (1, False)):
        device = open_digitizer(application(finger(flags="0942 0947")))
        frame = device.decode_report(b"\x01" + Finger(1, flags=flags).bytes(), 0)
        assert frame is not None and frame.contacts[0].confidence is confidence


def test_a_contact_unseen_is_up_where_the_class_says_so() -> None:
    digitizer = open_digitizer(HYBRID, 0x1FF7, 0x0013)
    digitizer.decode_report(hybrid(Finger(1), Finger(2), 2), 0)
    assert ids(digitizer.decode_report(hybrid(Finger(2), NOBODY, 1), 8 * MS)) == [2]


def test_the_first_contact_sets_the_range_of_all() -> None:
    wider = finger().replace(bytes.fromhex("26e803"), bytes.fromhex("2650c3"))
    frame = open_digitizer(application(finger(), wider)).decode_report(
        b"\x01" + Finger(1).bytes() + Finger(2, 1500, 1500).bytes(), 0
    )
    assert frame is not None and (frame.contacts[1].x, frame.contacts[1].y) == (1000, 1000)


def test_a_short_report_and_another_collections_are_counted_and_give_no_frame() -> None:
    digitizer = open_digitizer(HYBRID)
    for size in range(1, len(hybrid(Finger(1), Finger(2), 2))):
        assert digitizer.decode_report(hybrid(Finger(1), Finger(2), 2)[:size], 0) is None
    assert digitizer.decode_report(b"\x09\x01\x02", 0) is None
    assert (digitizer.counters.short_reports, digitizer.counters.foreign_reports) == (13, 1)


def test_a_serial_device_keeps_its_contacts_and_no_more_than_it_declares() -> None:
    digitizer = open_digitizer(SERIAL)
    frames = [digitizer.decode_report(b"\x01" + Finger(number).bytes(), 0) for number in range(8)]
    assert (ids(frames[1]), ids(frames[-1])) == ([0, 1], [0, 1, 2, 3, 4])
    assert digitizer.counters.excess_contacts == 3


def test_a_certified_panel_releases_120_ms_after_the_last_frame_and_nothing_expires_while_nothing_is_down() -> None:
    digitizer = open_digitizer(CERTIFIED)
    digitizer.decode_report(certified(Finger(1), NOBODY, 1, 1), 50 * MS)
    assert (digitizer.due_ns, digitizer.expire(169 * MS)) == (170 * MS, None)
    assert digitizer.expire(170 * MS) == TouchFrame(170 * MS, ())
    assert (digitizer.due_ns, digitizer.expire(400 * MS)) == (None, None)
    assert ids(digitizer.decode_report(certified(NOBODY, NOBODY, 2, 1), 500 * MS)) == []
    assert digitizer.expire(1000 * MS) is None


REST = Finger(1), NOBODY


@pytest.mark.parametrize(
    ("device", "report"),
    [((HYBRID, 0x1234, 1), hybrid(*REST, 1)), ((CERTIFIED, 0x0416, 0xC168), certified(*REST, 1, 1))],
)
def test_a_panel_that_reports_changes_keeps_a_resting_finger(device: tuple[bytes, int, int], report: bytes) -> None:
    """One without a certificate, and one that the kernel lists by its number."""
    digitizer = open_digitizer(*device)
    digitizer.decode_report(report, 0)
    assert (digitizer.due_ns, digitizer.expire(10_000 * MS)) == (None, None)
    assert digitizer.decode_report(LIFT_ALL, 20_000 * MS) == TouchFrame(20_000 * MS, ())
    assert digitizer.decode_report(LIFT_ALL, 20_001 * MS) is None


@pytest.mark.parametrize(
    ("first", "ticks", "expected_ms"),
    [(100, 180, 108), (100, 100, 100), (100, 5, 109), (100, 65535, 109), (65500, 44, 108)],
)
def test_scan_time_counts_while_it_agrees_with_host_time_over_a_wrap(first: int, ticks: int, expected_ms: int) -> None:
    digitizer = open_digitizer(CERTIFIED)
    digitizer.decode_report(certified(Finger(1), NOBODY, first, 1), 100 * MS)
    frame = digitizer.decode_report(certified(Finger(1), NOBODY, ticks, 1), 109 * MS)
    assert frame is not None and frame.scan_time_ns == expected_ms * MS


def test_a_touch_screen_comes_before_a_touch_pad_and_fingers_before_pens() -> None:
    pad = application(finger(), usage=TOUCH_PAD, report_id=7)
    pens = application(finger(collection=0x20), report_id=8)
    surface = open_digitizer(pens + pad + HYBRID).surface
    assert (surface.kind, surface.is_stylus) == (SurfaceKind.TOUCH_SCREEN, False)
    assert open_digitizer(pad).surface.kind is SurfaceKind.TOUCH_PAD


PAD = application(finger(), usage=TOUCH_PAD, report_id=0x11)


def pad(one: Finger) -> bytes:
    return b"\x11" + one.bytes()


def test_without_a_choice_the_surface_that_reports_is_decoded_and_the_first_with_a_contact_stays() -> None:
    digitizer, turned = open_digitizer(HYBRID + PAD), list[SurfaceKind]()
    digitizer.on_surface = lambda: turned.append(digitizer.surface.kind)
    reports = [hybrid(NOBODY, NOBODY, 0), pad(NOBODY), hybrid(NOBODY, NOBODY, 0), pad(Finger(3)), pad(Finger(3, 8))]
    assert [ids(digitizer.decode_report(report, 0)) for report in reports] == [[], [], [], [3], [3]]
    assert turned == [SurfaceKind.TOUCH_PAD, SurfaceKind.TOUCH_SCREEN, SurfaceKind.TOUCH_PAD]
    assert digitizer.decode_report(hybrid(Finger(1), NOBODY, 1), 0) is None  # it takes no finger's place
    assert (digitizer.counters.foreign_reports, digitizer.foreign_notice) == (1, None)
    pens = application(finger(collection=0x20), report_id=8)
    assert open_digitizer(HYBRID + pens).decode_report(b"\x08" + Finger(1).bytes(), 0) is None


def test_a_chosen_surface_stays_and_one_notice_names_the_reports_that_come_and_the_surfaces() -> None:
    digitizer, notices = open_digitizer(HYBRID + PAD, 0x1234, 1, 0x01), list[str]()
    digitizer.on_foreign = notices.append
    assert not any(digitizer.decode_report(pad(Finger(1)), 0) for _ in range(300))
    (notice,) = notices
    assert all(
        part in notice for part in ("reports 11 come", "1234:0001#01 (touch screen)", "1234:0001#11 (touch pad)")
    )
    assert digitizer.foreign_notice == notice
    digitizer.decode_report(hybrid(Finger(1), NOBODY, 1), 0)
    assert digitizer.foreign_notice is None
    assert open_digitizer(HYBRID + PAD, 0x1234, 1, 0x11).surface.kind is SurfaceKind.TOUCH_PAD
    with pytest.raises(DigitizerError, match=r"report 22.*1234:0001#01, 1234:0001#11"):
        open_digitizer(HYBRID + PAD, 0x1234, 1, 0x22)


@pytest.mark.parametrize(
    ("descriptor", "vendor_id", "says"),
    [
        (application(finger(), usage=PEN), 0, "no touch screen or touch pad"),
        (HYBRID, 0x056A, "Wacom.*/dev/input/event.*tactable list"),
    ],
)
def test_a_device_without_surface_or_of_another_driver_is_refused(descriptor: bytes, vendor_id: int, says: str) -> None:
    with pytest.raises(DigitizerError, match=says):
        open_digitizer(descriptor, vendor_id, 1)


def opened(recording: Recording) -> Digitizer:
    return open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)


def replayed(recording: Recording) -> Iterator[tuple[int, TouchFrame]]:
    """Report index and frame, without the watchdog: the golden run fed reports without the pauses."""
    digitizer = opened(recording)
    for report in recording.reports:
        frame = digitizer.decode_report(report.data, int(report.time_s * 1e9))
        if frame is not None:
            yield report.index, frame


@pytest.mark.parametrize("path", recording_params("synthetic", "*.hid"))
def test_synthetic_devices_give_the_expected_contacts(path: Path) -> None:
    expected = dict(json.loads(path.with_suffix(".expect.json").read_text())["expect"])
    frames = {
        index: sorted([contact.contact_id, contact.x, contact.y] for contact in frame.contacts if contact.tip)
        for index, frame in replayed(read_recording(path))
    }
    assert frames == {index: sorted(contacts) for index, contacts in expected.items()}


class KernelSlots:
    """What Linux's input layer does to our frames: slots keep their last position, moves below `fuzz` are damped."""

    def __init__(self, fuzz_x: int, fuzz_y: int) -> None:
        self.fuzz = (fuzz_x, fuzz_y)
        self.slots: dict[int, int] = {}
        self.positions: dict[int, tuple[int, int]] = {}

    def damp(self, contacts: tuple[Contact, ...]) -> list[tuple[int, int]]:
        left = self.slots.keys() - {contact.contact_id for contact in contacts}
        leaving = {contact_id: self.slots.pop(contact_id) for contact_id in left}
        for contact in contacts:
            if contact.contact_id not in self.slots:
                taken = {*self.slots.values(), *leaving.values()}
                self.slots[contact.contact_id] = next(slot for slot in range(100) if slot not in taken)
            self.move(self.slots[contact.contact_id], (contact.x, contact.y))
        return sorted(self.positions[slot] for slot in self.slots.values())

    def move(self, slot: int, position: tuple[int, int]) -> None:
        x, y = (
            damped(value, old, fuzz)
            for value, old, fuzz in zip(position, self.positions.get(slot, (0, 0)), self.fuzz, strict=True)
        )
        self.positions[slot] = (x, y)


def damped(value: int, old: int, fuzz: int) -> int:
    """Input layer's noise filter: steps below fuzz/2 vanish, below fuzz a quarter counts, below 2 fuzz a half."""
    step = abs(value - old)
    if fuzz and step < fuzz // 2:
        return old
    if step < fuzz:
        return (old * 3 + value) // 4
    return (old + value) // 2 if step < 2 * fuzz else value


@pytest.mark.parametrize("path", recording_params("golden", "*.jsonl.gz"))
def test_frames_equal_the_kernels_after_every_report(path: Path) -> None:
    """All 32, no exception: with the kernel's contact limit and noise filter nothing is left that differs."""
    header, *lines = map(json.loads, gzip.decompress(path.read_bytes()).splitlines())
    x, y = header["cols"].index("x"), header["cols"].index("y")
    kernel = {index: sorted((slot[x], slot[y]) for slot in events[-1][1]) for index, events in lines}
    recording = read_recording(RECORDINGS / "touch" / header["file"])
    slots = KernelSlots(header["abs"]["x"]["fuzz"], header["abs"]["y"]["fuzz"])
    ours = {index: slots.damp(frame.contacts) for index, frame in replayed(recording)}
    expected: list[tuple[int, int]] = []
    positions: list[tuple[int, int]] = []
    for report in recording.reports:
        expected = kernel.get(report.index, expected)
        positions = ours.get(report.index, positions)
        assert positions == expected, f"report {report.index}"


@pytest.mark.parametrize("path", recording_params("touch", "*.hid"))
def test_no_contact_of_a_panel_that_repeats_stays_down_150_ms_after_the_last_report(path: Path) -> None:
    recording = read_recording(path)
    digitizer = opened(recording)
    if not digitizer.plan.quirks.releases_when_silent:
        digitizer.release_after_ns = RELEASE_AFTER_NS
    frame = TouchFrame(0, ())
    reports = [(int(report.time_s * 1e9), report.data) for report in recording.reports]
    last_ns = 0
    for now_ns, data in [*reports, (reports[-1][0] + 1000 * MS if reports else 0, b"")]:
        for tick_ns in range(last_ns, min(now_ns, last_ns + 200 * MS), 10 * MS):
            frame = digitizer.expire(tick_ns) or frame
        assert now_ns - last_ns < 150 * MS or not frame.contacts
        frame = digitizer.decode_report(data, now_ns) or frame
        last_ns = now_ns
        check_frame(digitizer, frame)


@pytest.mark.parametrize("path", recording_params("not_touch", "*.hid"))
def test_no_tablet_mouse_or_keyboard_opens_as_a_digitizer(path: Path) -> None:
    recording = read_recording(path)
    with pytest.raises((DigitizerError, DescriptorError)):
        opened(recording)


def test_an_id_that_comes_down_in_the_frame_in_which_it_lifted_is_another_finger() -> None:
    """As the kernel gives it another tracking id; it keeps its number until it lifts."""
    digitizer = open_digitizer(HYBRID)
    assert ids(digitizer.decode_report(hybrid(Finger(1), NOBODY, 1), 0)) == [1]
    assert ids(digitizer.decode_report(hybrid(Finger(1, flags=UP), Finger(1, 900), 2), 8 * MS)) == [1 + AGAIN]
    assert ids(digitizer.decode_report(hybrid(Finger(1, 900), Finger(2), 2), 16 * MS)) == [1 + AGAIN, 2]
    assert digitizer.decode_report(hybrid(Finger(2), Finger(1, flags=UP), 3), 24 * MS) is None
    assert ids(digitizer.decode_report(hybrid(Finger(1, 500), NOBODY, 0), 25 * MS)) == [2, 1 + 2 * AGAIN]
    assert ids(digitizer.decode_report(hybrid(Finger(1, flags=UP), Finger(2, flags=UP), 2), 33 * MS)) == []


@pytest.mark.parametrize(
    ("vendor_id", "product_id", "is_win8", "is_serial", "expected"),
    [
        (0x0596, 0x0500, False, False, quirks.THREE_M),
        (0x1FF7, 0x0013, False, False, quirks.UNSEEN_MEANS_UP),
        (0x0486, 0x0185, False, False, quirks.CONFIDENCE_MINUS_ONE),
        (0x10C4, 0x81B9, False, False, quirks.SERIAL),
        (0x0EEF, 0x72FA, False, False, quirks.EGALAX),
        (0xFFFE, 1, False, False, quirks.GENERIC),
        (0xFFFE, 1, True, False, quirks.WIN8),
        (0x0596, 0x0500, True, False, quirks.WIN8),  # certified, which its kin in the table is not
        (0xFFFE, 1, False, True, quirks.SERIAL),  # never has stale slots
    ],
)
def test_a_device_has_its_class_by_certification_then_by_number_then_by_slots(
    vendor_id: int, product_id: int, is_win8: bool, is_serial: bool, expected: quirks.QuirkClass
) -> None:
    assert quirks.quirks_for(vendor_id, product_id, is_win8=is_win8, is_serial=is_serial) == expected


def test_wacom_is_left_to_its_own_driver() -> None:
    assert quirks.vendor_with_own_driver(0x056A) == "Wacom"
    assert quirks.vendor_with_own_driver(0x0596) is None
