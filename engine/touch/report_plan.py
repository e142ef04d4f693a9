"""Report layouts prepared for decoding: where each field of a contact slot is, as shifts and masks."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from engine.touch.descriptor import ContactLayout, Field, ReportLayout, Surface
from engine.touch.quirks import QuirkClass, Validity, quirks_for

# Linux takes 10 contacts where Contact Count Maximum is absent or above 250 (255 stands for "unset").
_DEFAULT_MAXIMUM_CONTACTS = 10
_LARGEST_MAXIMUM_CONTACTS = 250  # MT_MAX_MAXCONTACT of hid-multitouch.c
# Shift and mask of a flag or number; shift, mask, sign bit and range of a position. `(value ^ sign) - sign` reads
# `value` as two's complement.
NumberBits = tuple[int, int]
PositionBits = tuple[int, int, int, int, int]


@dataclass(frozen=True, slots=True)
class Bits:
    """A field in the bytes start..stop of a report."""

    start: int
    stop: int
    shift: int
    mask: int


class SlotPlan(NamedTuple):
    """Where the fields of one contact slot are in a report; a mask of 0 stands for a field that the device lacks."""

    memory: list[Any]  # the bits that the slot held last, and the contact that they were decoded to
    place: slice
    tip: NumberBits
    contact_id: NumberBits
    valid: NumberBits
    hover: NumberBits
    confidence: NumberBits
    x: PositionBits
    y: PositionBits


@dataclass(frozen=True, slots=True)
class ReportPlan:
    """Places of all fields in one report, prepared for decoding."""

    needed_bytes: int
    slots: tuple[SlotPlan, ...]
    count: Bits | None
    scan_time: Bits | None


@dataclass(frozen=True, slots=True)
class SurfacePlan:
    """How the reports of a surface are decoded: the quirks of its device, and the plan of each report by its ID.

    count_is_accurate: slots beyond the contact count are stale. count_is_apart: no report has contacts and their count.
    """

    quirks: QuirkClass
    maximum_contacts: int
    reports: dict[int, ReportPlan]
    count_is_accurate: bool
    count_is_apart: bool


def plan_surface(surface: Surface, vendor_id: int, product_id: int) -> SurfacePlan:
    """Prepare the reports of a surface for decoding."""
    quirks = quirks_for(vendor_id, product_id, is_win8=surface.is_win8, is_serial=len(surface.contacts) == 1)
    # Reports of our own making (sources/own_reports.py) have no numbers.
    tells_palms = surface.is_win8 or not (vendor_id or product_id)
    plans = {report.report_id: build_plan(report, surface, quirks, tells_palms) for report in surface.reports}
    has_count = any(plan.count for plan in plans.values())
    is_apart = has_count and not any(plan.slots and plan.count for plan in plans.values())
    is_accurate = quirks.count_is_accurate and has_count
    return SurfacePlan(quirks, _maximum_contacts(surface, quirks), plans, is_accurate, is_apart)


def build_plan(report: ReportLayout, surface: Surface, quirks: QuirkClass, tells_palms: bool) -> ReportPlan:
    """Prepare a report layout for decoding; tells_palms: a contact without confidence is a palm."""
    slots = tuple(_build_slot(contact, surface, quirks, tells_palms) for contact in report.contacts)
    count = None if report.contact_count is None else _bits(report.contact_count)
    scan_time = None if report.scan_time is None else _bits(report.scan_time)
    stops = [*(slot.place.stop for slot in slots), *(part.stop for part in (count, scan_time) if part is not None)]
    return ReportPlan(max(stops), slots, count, scan_time)


def _build_slot(contact: ContactLayout, surface: Surface, quirks: QuirkClass, tells_palms: bool) -> SlotPlan:
    validity = {
        Validity.ALWAYS: None,
        Validity.IN_RANGE: contact.in_range,
        Validity.TIP: contact.tip,
        Validity.CONFIDENCE: contact.confidence,
    }[quirks.validity]
    hover = contact.in_range if quirks.hovers else None
    confidence = contact.confidence if tells_palms else None
    used = (contact.tip, contact.contact_id, validity, hover, confidence, contact.x, contact.y)
    fields = [field for field in used if field is not None]
    start = min(field.bit for field in fields) // 8
    stop = max(field.bit + field.size_bits + 7 for field in fields) // 8
    return SlotPlan(
        memory=[None, None],
        place=slice(start, stop),
        tip=_shift_and_mask(contact.tip, start),
        contact_id=_shift_and_mask(contact.contact_id, start),
        valid=_shift_and_mask(validity, start),
        hover=_shift_and_mask(hover, start),
        confidence=_shift_and_mask(confidence, start),
        x=(*_shift_and_mask(contact.x, start), *_limits(contact.x, surface.x)),
        y=(*_shift_and_mask(contact.y, start), *_limits(contact.y, surface.y)),
    )


def _bits(field: Field) -> Bits:
    start = field.bit // 8
    return Bits(start, (field.bit + field.size_bits + 7) // 8, *_shift_and_mask(field, start))


def _shift_and_mask(field: Field | None, start: int) -> tuple[int, int]:
    return (0, 0) if field is None else (field.bit - 8 * start, (1 << field.size_bits) - 1)


def _limits(field: Field, axis: Field) -> tuple[int, int, int]:
    """Sign bit of a field and the range of its axis."""
    sign = 1 << field.size_bits - 1 if field.is_signed else 0
    return sign, axis.logical_minimum, axis.logical_maximum


def read(bits: Bits, report: bytes) -> int:
    """The unsigned value of a field."""
    if bits.stop - bits.start == 1:  # every contact count: 4 times as fast
        return report[bits.start] >> bits.shift & bits.mask
    return int.from_bytes(report[bits.start : bits.stop], "little") >> bits.shift & bits.mask


def _maximum_contacts(surface: Surface, quirks: QuirkClass) -> int:
    """Contacts that are down at once at most."""
    if quirks.maximum_contacts is not None:
        return quirks.maximum_contacts
    declared = 0 if surface.contact_count_maximum is None else surface.contact_count_maximum.logical_maximum
    return declared if 1 <= declared <= _LARGEST_MAXIMUM_CONTACTS else _DEFAULT_MAXIMUM_CONTACTS
