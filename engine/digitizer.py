"""Reports of a digitizer to touch frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from engine.descriptor import ContactLayout, Field, ReportLayout, Surface, SurfaceKind, read_surfaces
from engine.quirks import Key, QuirkClass, Validity, quirks_for, vendor_with_own_driver

# Frames of live digitizers come every 2..26 ms: later than this inside a frame, its rest is lost.
FRAME_SILENCE_NS = 30_000_000
# Four times the slowest frame period; 10 of 89 recorded devices lose a release and stay silent for up to 19 s.
RELEASE_AFTER_NS = 120_000_000
# A scan time that is further than this from host time has been reset or wrapped.
SCAN_TIME_TOLERANCE_NS = 25_000_000
SCAN_TIME_TICK_NS = 100_000

# Linux takes 10 contacts where Contact Count Maximum is absent or above 250 (255 stands for "unset").
_DEFAULT_MAXIMUM_CONTACTS = 10
_LARGEST_MAXIMUM_CONTACTS = 250
# Reports that wait for a contact count in another report: more than any frame needs, few enough to bound memory.
_HELD_REPORTS = 16

# The hot path: without the search for a method, and half the time of calling a named tuple's class.
_from_bytes, _new = int.from_bytes, tuple.__new__

_KIND_PREFERENCE = (SurfaceKind.TOUCH_SCREEN, SurfaceKind.MULTI_POINT, SurfaceKind.TOUCH_PAD)


class DigitizerError(Exception):
    """The device cannot be used as a touch surface: why."""


class Contact(NamedTuple):
    """One finger: position in the logical units of the surface, always inside its logical range.

    `tip` is False while it hovers; `confidence` is False where the device takes it for a palm.
    """

    contact_id: int
    x: int
    y: int
    tip: bool
    confidence: bool = True


class TouchFrame(NamedTuple):
    """Every contact in range at one moment, touching or hovering; a contact that left is not listed.

    `time_ns` is host time of the report that completed the frame. `scan_time_ns` is the device's own time of the
    scan on the host's time axis, free of transport jitter; `None` where the device reports none.
    """

    time_ns: int
    contacts: tuple[Contact, ...]
    scan_time_ns: int | None = None


@dataclass(slots=True)
class DigitizerCounters:
    """What became of the reports: the hot path counts where others would log."""

    frames: int = 0
    foreign_reports: int = 0
    short_reports: int = 0
    lost_frames: int = 0
    excess_contacts: int = 0
    expired_frames: int = 0


class Digitizer:
    """Assembles the reports of one surface into touch frames as Linux's hid-multitouch does.

    One thread; `decode_report` and `expire` never raise. Times are nanoseconds of one monotonic clock.
    """

    def __init__(self, surface: Surface, vendor_id: int = 0, product_id: int = 0) -> None:
        contacts = sum(len(report.contacts) for report in surface.reports)
        has_count = any(report.contact_count is not None for report in surface.reports)
        self.surface = surface
        self.quirks = quirks_for(vendor_id, product_id, is_win8=surface.is_win8, is_serial=contacts == 1)
        self.counters = DigitizerCounters()
        self.maximum_contacts = _maximum_contacts(surface, self.quirks)
        self._plans = {report.report_id: _build_plan(report, surface, self.quirks) for report in surface.reports}
        self._uses_report_ids = surface.uses_report_ids
        self._count_is_accurate = self.quirks.count_is_accurate and has_count
        self._key = self.quirks.key
        self._ignores_duplicates = self.quirks.ignores_duplicates
        self._unseen_means_up = self.quirks.unseen_means_up
        self._count_is_apart = has_count and not any(plan.slots and plan.count for plan in self._plans.values())
        self._active: dict[int, Contact] = {}  # by key, oldest first
        self._seen: set[int] = set()  # keys this frame mentioned
        self._taken = 0  # contacts active or mentioned in this frame
        self._received = 0
        self._expected = 0
        self._ticks = 0
        self._frame_ticks = 0
        self._scan_time_ns = 0
        self._report_ns = 0
        self._frame_ns = 0
        self._is_shown = False  # the last frame listed a contact
        self._held: list[tuple[_Plan, bytes]] = []  # reports that wait for their count
        self._announced: int | None = None  # count that waits for its reports

    def decode_report(self, report: bytes, now_ns: int) -> TouchFrame | None:
        """Take one report as the device sent it, report ID first where it has one.

        The frame it completes; `None` when the frame goes on or the report is another collection's or too short.
        """
        report_id = report[0] if self._uses_report_ids and report else 0
        plan = self._plans.get(report_id)
        if plan is None:
            self.counters.foreign_reports += 1
            return None
        if len(report) < plan.needed_bytes:
            self.counters.short_reports += 1
            return None
        is_late = now_ns - self._report_ns > FRAME_SILENCE_NS
        self._report_ns = now_ns
        if self._count_is_apart:
            return self._decode_apart(plan, report, now_ns, is_late)
        ticks = _read(plan.scan_time, report) if plan.scan_time is not None else self._ticks
        # A lost report shifts the frames after it only where the count says which slots to read.
        if self._received and self._count_is_accurate and (is_late or ticks != self._ticks):
            self.counters.lost_frames += 1
            self._start_frame()
        if plan.count is not None:
            self._expect(_read(plan.count, report), ticks)
        self._ticks = ticks
        self._take_contacts(plan, report)
        return None if self._received < self._expected else self._complete_frame(plan, ticks, now_ns)

    def expire(self, now_ns: int) -> TouchFrame | None:
        """Watchdog: a frame without contacts when some were down and 120 ms brought no further frame, else `None`."""
        if not self._is_shown or now_ns - self._frame_ns < RELEASE_AFTER_NS:
            return None
        self.counters.expired_frames += 1
        self._active.clear()
        self._start_frame()
        self._is_shown = False
        return TouchFrame(now_ns, ())

    def _expect(self, count: int, ticks: int) -> None:
        """The first report of a frame carries the total, the others 0; some devices repeat the total in each."""
        if count or (self._received == 0 and ticks != self._ticks and self.quirks.frame_may_be_empty):
            self._expected = count

    def _decode_apart(self, plan: _Plan, report: bytes, now_ns: int, is_late: bool) -> TouchFrame | None:
        """Contacts and their count in different reports, whichever comes first: each waits for the other."""
        if is_late:
            self._held.clear()
            self._announced = None
            self._start_frame()
        if plan.count is not None:
            self._announced = _read(plan.count, report)
        else:
            self._held.append((plan, report))
            del self._held[:-_HELD_REPORTS]
        if self._announced is None or not self._held:
            return None
        self._expected = self._announced
        for held_plan, held_report in self._held:
            self._take_contacts(held_plan, held_report)
        self._held.clear()
        if self._received < self._expected:
            return None
        self._announced = None
        return self._complete_frame(plan, _read(plan.scan_time, report) if plan.scan_time else 0, now_ns)

    def _take_contacts(self, plan: _Plan, report: bytes) -> None:
        """Take the contacts of a report in order, until the frame has as many as it announced."""
        active, seen, received = self._active, self._seen, self._received
        wanted = self._expected if self._count_is_accurate else received + len(plan.slots)
        is_numbered = self._key is Key.SLOT_IS_CONTACT_NUMBER
        for slot in plan.slots:
            if received >= wanted:
                break
            bits = _from_bytes(report[slot.start : slot.stop], "little")
            if slot.valid_mask and not bits >> slot.valid_shift & slot.valid_mask:
                received += 1
                continue
            contact_id = bits >> slot.id_shift & slot.id_mask
            if is_numbered:
                contact_id = received
            is_active = contact_id in active
            if is_active and self._ignores_duplicates and contact_id in seen:
                continue
            received += 1
            if not is_active and not self._admit(contact_id):
                self.counters.excess_contacts += 1
                continue
            seen.add(contact_id)
            tip = bits >> slot.tip_shift & slot.tip_mask != 0
            if tip or bits >> slot.hover_shift & slot.hover_mask:
                active[contact_id] = _contact(slot, bits, contact_id, tip)
            elif is_active:
                del active[contact_id]
        self._received = received

    def _admit(self, contact_id: int) -> bool:
        """Whether there is room for a new contact; one that leaves keeps its place until the frame is complete."""
        if self._key is Key.CONTACT_ID:
            self._taken += 1
            return self._taken <= self.maximum_contacts
        if self._key is Key.SLOT_IS_CONTACT_ID_MINUS_ONE:
            return 1 <= contact_id <= self.maximum_contacts
        return contact_id < self.maximum_contacts

    def _complete_frame(self, plan: _Plan, ticks: int, now_ns: int) -> TouchFrame:
        if self._unseen_means_up:
            for contact_id in self._active.keys() - self._seen:
                del self._active[contact_id]
        contacts = tuple(self._active.values())
        self._start_frame()
        self._is_shown = bool(contacts)
        self._frame_ns = now_ns
        self.counters.frames += 1
        if plan.scan_time is None:
            return _new(TouchFrame, (now_ns, contacts, None))
        return _new(TouchFrame, (now_ns, contacts, self._join_scan_time(plan.scan_time, ticks, now_ns)))

    def _start_frame(self) -> None:
        self._received = 0
        self._seen.clear()
        self._taken = len(self._active)

    def _join_scan_time(self, scan_time: _Bits, ticks: int, now_ns: int) -> int:
        """Scan time on the host's axis: steps of the device's clock while they agree with host time, else host time.

        Devices reset the counter at a new touch, wrap it at its size rather than the declared maximum, and their
        100 us are 92..131 us: only steps are taken, and only within the tolerance.
        """
        step_ns = (ticks - self._frame_ticks & scan_time.mask) * SCAN_TIME_TICK_NS
        joined_ns = self._scan_time_ns + step_ns
        self._frame_ticks = ticks
        self._scan_time_ns = joined_ns if abs(joined_ns - now_ns) <= SCAN_TIME_TOLERANCE_NS else now_ns
        return self._scan_time_ns


def open_digitizer(descriptor: bytes, vendor_id: int = 0, product_id: int = 0) -> Digitizer:
    """Digitizer of the interface's best surface: a touch screen before a touch pad, fingers before a stylus.

    Raises `DescriptorError` when the descriptor is broken, `DigitizerError` when it holds no touch surface.
    """
    vendor = vendor_with_own_driver(vendor_id)
    if vendor is not None:
        raise DigitizerError(f"{vendor} device {vendor_id:04x}:{product_id:04x}: driven by its own driver, not by ours")
    surfaces = read_surfaces(descriptor)
    if not surfaces:
        raise DigitizerError(f"device {vendor_id:04x}:{product_id:04x} has no touch screen or touch pad")
    return Digitizer(min(surfaces, key=_rank), vendor_id, product_id)


def _rank(surface: Surface) -> tuple[bool, int, bool, int]:
    """Smaller is better; the first of equals wins."""
    preference = _KIND_PREFERENCE.index(surface.kind)
    return surface.is_stylus, preference, not surface.has_contact_ids, -surface.contacts_per_report


# ---- plans -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Bits:
    """A field in the bytes start..stop of a report."""

    start: int
    stop: int
    shift: int
    mask: int


@dataclass(frozen=True, slots=True)
class _Slot:
    """A contact in the bytes start..stop of a report; a mask of 0 stands for a field the device does not have."""

    start: int
    stop: int
    tip_shift: int
    tip_mask: int
    id_shift: int
    id_mask: int
    valid_shift: int
    valid_mask: int
    hover_shift: int
    hover_mask: int
    confidence_shift: int
    confidence_mask: int
    x_shift: int
    x_mask: int
    x_sign: int
    x_minimum: int
    x_maximum: int
    y_shift: int
    y_mask: int
    y_sign: int
    y_minimum: int
    y_maximum: int


@dataclass(frozen=True, slots=True)
class _Plan:
    """A report layout compiled for decoding."""

    needed_bytes: int
    slots: tuple[_Slot, ...]
    count: _Bits | None
    scan_time: _Bits | None


def _build_plan(report: ReportLayout, surface: Surface, quirks: QuirkClass) -> _Plan:
    slots = tuple(_build_slot(contact, surface, quirks) for contact in report.contacts)
    count = None if report.contact_count is None else _bits(report.contact_count)
    scan_time = None if report.scan_time is None else _bits(report.scan_time)
    stops = [part.stop for part in (*slots, count, scan_time) if part is not None]
    return _Plan(max(stops), slots, count, scan_time)


def _build_slot(contact: ContactLayout, surface: Surface, quirks: QuirkClass) -> _Slot:
    validity = {
        Validity.ALWAYS: None,
        Validity.IN_RANGE: contact.in_range,
        Validity.TIP: contact.tip,
        Validity.CONFIDENCE: contact.confidence,
    }[quirks.validity]
    hover = contact.in_range if quirks.hovers else None
    used = (contact.tip, contact.contact_id, validity, hover, contact.confidence, contact.x, contact.y)
    fields = [field for field in used if field is not None]
    start = min(field.bit for field in fields) // 8
    stop = max(field.bit + field.size_bits + 7 for field in fields) // 8
    tip, contact_id, valid, hovering, confidence, x, y = (_shift_and_mask(field, start) for field in used)
    x_limits, y_limits = _limits(contact.x, surface.x), _limits(contact.y, surface.y)
    return _Slot(start, stop, *tip, *contact_id, *valid, *hovering, *confidence, *x, *x_limits, *y, *y_limits)


def _bits(field: Field) -> _Bits:
    start = field.bit // 8
    return _Bits(start, (field.bit + field.size_bits + 7) // 8, *_shift_and_mask(field, start))


def _shift_and_mask(field: Field | None, start: int) -> tuple[int, int]:
    return (0, 0) if field is None else (field.bit - 8 * start, (1 << field.size_bits) - 1)


def _limits(field: Field, axis: Field) -> tuple[int, int, int]:
    """Sign bit of a field and the range of its axis; `(value ^ sign) - sign` reads `value` as two's complement."""
    sign = 1 << field.size_bits - 1 if field.is_signed else 0
    return sign, axis.logical_minimum, axis.logical_maximum


def _read(bits: _Bits, report: bytes) -> int:
    if bits.stop - bits.start == 1:  # every contact count: 4 times as fast
        return report[bits.start] >> bits.shift & bits.mask
    return _from_bytes(report[bits.start : bits.stop], "little") >> bits.shift & bits.mask


def _contact(slot: _Slot, bits: int, contact_id: int, tip: bool) -> Contact:
    """Contact of a slot, its position clamped into the logical range of the surface.

    Clamped, not dropped: a finger on the rim reads a few units outside and must not be lost there.
    """
    x = (bits >> slot.x_shift & slot.x_mask ^ slot.x_sign) - slot.x_sign
    y = (bits >> slot.y_shift & slot.y_mask ^ slot.y_sign) - slot.y_sign
    if not slot.x_minimum <= x <= slot.x_maximum:
        x = min(max(x, slot.x_minimum), slot.x_maximum)
    if not slot.y_minimum <= y <= slot.y_maximum:
        y = min(max(y, slot.y_minimum), slot.y_maximum)
    confidence = not slot.confidence_mask or bits >> slot.confidence_shift & slot.confidence_mask != 0
    return _new(Contact, (contact_id, x, y, tip, confidence))


def _maximum_contacts(surface: Surface, quirks: QuirkClass) -> int:
    if quirks.maximum_contacts is not None:
        return quirks.maximum_contacts
    declared = 0 if surface.contact_count_maximum is None else surface.contact_count_maximum.logical_maximum
    return declared if 1 <= declared <= _LARGEST_MAXIMUM_CONTACTS else _DEFAULT_MAXIMUM_CONTACTS
