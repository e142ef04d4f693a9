"""Parses a HID report descriptor into the layout of each touch surface: where each contact is in which report."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

from engine.touch.hid_items import Application, Declarations, DescriptorError, Field, FieldUse, read_declarations

__all__ = ["ContactLayout", "DescriptorError", "Field", "ReportLayout", "Surface", "SurfaceKind", "read_surfaces"]

_MAXIMUM_FIELD_BITS = 32  # HID 1.11 allows 32 bits a field
# HID Usage Tables, page in the upper 16 bits: 0x01 Generic Desktop, 0x0D Digitizers, 0xFF00 of Microsoft
_DIGITIZER_PAGE = 0x000D_0000
_X, _Y, _TIP, _CONTACT_ID = 0x0001_0030, 0x0001_0031, 0x000D_0042, 0x000D_0051  # page, then usage
_TOUCH, _TRANSDUCER_INDEX = 0x000D_0033, 0x000D_0038
_CONTACT_USAGES = {
    _X: "x",
    _Y: "y",
    _TIP: "tip",
    _CONTACT_ID: "contact_id",
    0x000D_0032: "in_range",
    0x000D_0047: "confidence",
}
# Apple's touch bars say so; many others send Touch beside Tip Switch, where it is something else.
_STAND_INS = {_TOUCH: _TIP, _TRANSDUCER_INDEX: _CONTACT_ID}
_CONTACT_COUNT, _CONTACT_COUNT_MAXIMUM, _SCAN_TIME = 0x000D_0054, 0x000D_0055, 0x000D_0056
_CERTIFICATION_BLOB = 0xFF00_00C5  # of Windows touch devices; it marks the kernel's class Win8
_REQUIRED_USAGES = (_X, _Y, _TIP, _CONTACT_ID, _CONTACT_COUNT)
_INPUT_USAGES = (*_CONTACT_USAGES, *_STAND_INS, _CONTACT_COUNT, _SCAN_TIME)
_FEATURE_USAGES = (_CONTACT_COUNT_MAXIMUM, _CERTIFICATION_BLOB)


class SurfaceKind(Enum):
    """Application of a touch collection on the Digitizer page."""

    TOUCH_SCREEN = 0x04
    TOUCH_PAD = 0x05
    MULTI_POINT = 0x0C


_KIND_PREFERENCE = (SurfaceKind.TOUCH_SCREEN, SurfaceKind.MULTI_POINT, SurfaceKind.TOUCH_PAD)
_APPLICATIONS = {_DIGITIZER_PAGE | kind.value: kind for kind in SurfaceKind}


@dataclass(frozen=True, slots=True)
class ContactLayout:
    """Fields of one contact in a report; `None` where the device has no such field."""

    x: Field
    y: Field
    tip: Field
    contact_id: Field | None = None
    in_range: Field | None = None
    confidence: Field | None = None


@dataclass(frozen=True, slots=True)
class ReportLayout:
    """One input report of a surface: its contacts in order, and its fields about the whole frame."""

    report_id: int
    contacts: tuple[ContactLayout, ...]
    contact_count: Field | None
    scan_time: Field | None


@dataclass(frozen=True, slots=True)
class Surface:
    """One touch application of an interface: its input reports, and the most contacts that it says it tells apart.

    `is_win8`: it has contact IDs and the certification blob. `is_stylus`: its contacts are pens. A feature is the
    application's own, else any of the interface.
    """

    kind: SurfaceKind
    is_stylus: bool
    is_win8: bool
    uses_report_ids: bool
    reports: tuple[ReportLayout, ...]
    contact_count_maximum: Field | None

    @property
    def report_id(self) -> int:
        """ID of the report with its contacts, by which a surface is chosen; 0 for an interface without report IDs."""
        return next(report.report_id for report in self.reports if report.contacts)

    @property
    def label(self) -> str:
        """Kind of the surface in words."""
        return self.kind.name.lower().replace("_", " ") + " for pens" * self.is_stylus

    def name(self, vendor_id: int, product_id: int) -> str:
        """Name of the surface for commands, such as 17ef:6161#38: vendor, product and report ID in hex."""
        return f"{vendor_id:04x}:{product_id:04x}#{self.report_id:02x}"

    @property
    def contacts(self) -> tuple[ContactLayout, ...]:
        """Contacts of all reports; never empty."""
        return tuple(contact for report in self.reports for contact in report.contacts)

    @property
    def contacts_per_report(self) -> int:
        """Most contacts one report carries; 1 is a serial device."""
        return max(len(report.contacts) for report in self.reports)

    @property
    def x(self) -> Field:
        """X of the first contact: range and extent of the surface along X."""
        return self.contacts[0].x

    @property
    def y(self) -> Field:
        """Y of the first contact: range and extent of the surface along Y."""
        return self.contacts[0].y

    @property
    def rank(self) -> tuple[bool, int, bool, int]:
        """Sort key, the best surface is least: fingers before pens, a touch screen before a touch pad."""
        preference = _KIND_PREFERENCE.index(self.kind)
        return self.is_stylus, preference, not self.has_contact_ids, -self.contacts_per_report

    @property
    def has_contact_ids(self) -> bool:
        """Whether the device names its contacts; without names it has one."""
        return self.contacts[0].contact_id is not None


def read_surfaces(descriptor: bytes, refused: list[DescriptorError] | None = None) -> tuple[Surface, ...]:
    """Touch surfaces of an interface, in descriptor order; empty when it is not a touch device.

    A surface has contacts with tip, X and Y in an application Touch Screen, Touch Pad or Multiple Point Digitizer.
    One with a touch field that cannot be decoded is left out, and the reason added to `refused`. Raises
    `DescriptorError` when the bytes break the grammar, or no surface can be decoded.
    """
    declared = read_declarations(descriptor, _INPUT_USAGES, _FEATURE_USAGES, constant_usage=_CONTACT_ID)
    surfaces, refused = list[Surface](), [] if refused is None else refused
    for application in declared.applications:
        try:
            surface = _build_surface(application, declared) if application.usage in _APPLICATIONS else None
        except DescriptorError as error:
            refused.append(error)
            continue
        if surface is not None:
            surfaces.append(surface)
    if refused and not surfaces:
        raise refused[0]
    return tuple(surfaces)


def _build_surface(application: Application, declared: Declarations) -> Surface | None:
    """The surface of an application, `None` when it holds no contact."""
    all_uses = [use for report_uses in application.inputs.values() for use in report_uses]
    given = {use.usage for use in all_uses}
    stand_ins = {usage: meant for usage, meant in _STAND_INS.items() if meant not in given}
    named = [use._replace(usage=stand_ins.get(use.usage, use.usage)) for use in all_uses]
    uses = [use for use in named if use.usage not in _STAND_INS and _is_readable(use, declared)]
    fingers = [use for use in uses if not use.is_stylus]
    is_stylus = not any(use.usage == _X for use in fingers)
    reports = _build_reports(uses if is_stylus else fingers, declared)
    if not any(report.contacts for report in reports):
        return None
    blob = _feature(_CERTIFICATION_BLOB, application, declared)
    return Surface(
        kind=_APPLICATIONS[application.usage],
        is_stylus=is_stylus,
        is_win8=blob is not None and any(report.contacts[0].contact_id for report in reports if report.contacts),
        uses_report_ids=declared.uses_report_ids,
        reports=tuple(report for report in reports if report.contacts or report.contact_count is not None),
        contact_count_maximum=_feature(_CONTACT_COUNT_MAXIMUM, application, declared),
    )


def _build_reports(uses: list[FieldUse], declared: Declarations) -> list[ReportLayout]:
    has_contact_ids = any(use.usage == _CONTACT_ID for use in uses)
    by_report: dict[int, list[FieldUse]] = {}
    for use in uses:
        by_report.setdefault(use.field.report_id, []).append(use)
    return [_build_report(report_id, uses, has_contact_ids, declared) for report_id, uses in by_report.items()]


def _build_report(report_id: int, uses: list[FieldUse], has_contact_ids: bool, declared: Declarations) -> ReportLayout:
    frame_fields = {use.usage: _field(use, declared) for use in uses if use.usage not in _CONTACT_USAGES}
    contacts = [_build_contact(group, declared) for group in _contact_groups(uses, has_contact_ids)]
    return ReportLayout(
        report_id=report_id,
        # Without contact IDs nothing tells two contacts apart: one is what such a device can report.
        contacts=tuple(contacts if has_contact_ids else contacts[:1]),
        contact_count=frame_fields.get(_CONTACT_COUNT),
        scan_time=frame_fields.get(_SCAN_TIME),
    )


def _contact_groups(uses: list[FieldUse], has_contact_ids: bool) -> Iterator[dict[int, FieldUse]]:
    """Split fields into contacts: a repeated usage starts the next one, because not every device names collections."""
    required = {_X, _Y, _TIP, _CONTACT_ID} if has_contact_ids else {_X, _Y, _TIP}
    group: dict[int, FieldUse] = {}
    for use in uses:
        if use.usage not in _CONTACT_USAGES:
            continue
        if use.usage in group and required <= group.keys():
            yield group
            group = {}
        group.setdefault(use.usage, use)
    if required <= group.keys():
        yield group


def _build_contact(group: dict[int, FieldUse], declared: Declarations) -> ContactLayout:
    for usage in (_X, _Y):
        axis = group[usage].field
        if axis.logical_minimum >= axis.logical_maximum:
            problem = f"position whose logical minimum {axis.logical_minimum} is not below its maximum"
            raise DescriptorError(problem, group[usage].offset, axis.logical_maximum)
    return ContactLayout(**{_CONTACT_USAGES[usage]: _field(use, declared) for usage, use in group.items()})


def _is_readable(use: FieldUse, declared: Declarations) -> bool:
    """Whether a field can be read; an unreadable optional field is left out, a required one refuses the device."""
    if not 1 <= use.field.size_bits <= _MAXIMUM_FIELD_BITS:
        problem = f"touch field outside 1..{_MAXIMUM_FIELD_BITS} bits"
    elif declared.uses_report_ids and use.field.report_id == 0:
        problem = "touch field before the first report ID"
    else:
        return True
    if use.usage in _REQUIRED_USAGES:
        raise DescriptorError(problem, use.offset, use.field.size_bits)
    return False


def _field(use: FieldUse, declared: Declarations) -> Field:
    """The field counted from the report's first byte."""
    return replace(use.field, bit=use.field.bit + 8) if declared.uses_report_ids else use.field


def _feature(usage: int, application: Application, declared: Declarations) -> Field | None:
    """The first feature of a usage; the certification blob only as Windows asks for it, 256 bytes."""
    for use in (*application.features, *declared.features):
        is_blob = use.report_count == 256 and use.field.size_bits == 8
        if use.usage == usage and _is_readable(use, declared) and (is_blob or usage != _CERTIFICATION_BLOB):
            return _field(use, declared)
    return None
