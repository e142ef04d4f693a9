"""Parses the items of a HID report descriptor into the fields that they declare (HID 1.11 section 6.2.2)."""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from base.errors import TactableError

# Linux refuses longer descriptors and longer reports (HID_MAX_DESCRIPTOR_SIZE, HID_MAX_BUFFER_SIZE).
MAXIMUM_DESCRIPTOR_BYTES = 4096
MAXIMUM_REPORT_BITS = 8 * 16384  # HID_MAX_BUFFER_SIZE in bits
MAXIMUM_DEPTH = 32  # real devices nest 3 collections and push once or twice

_MILLIMETRES_PER_UNIT = {1: 10.0, 3: 25.4}  # system nibble: SI linear counts centimetres, English linear inches

_LONG_ITEM = 0xFE  # HID 1.11, 6.2.2.3
_MAIN, _GLOBAL, _LOCAL = 0, 1, 2
_INPUT, _FEATURE = 0x8, 0xB  # HID 1.11, 6.2.2.4
_CONSTANT, _VARIABLE, _RELATIVE = 0x01, 0x02, 0x04
_APPLICATION_COLLECTION = 0x01
_STYLUS = 0x000D_0020  # HID Usage Tables, 0x0D:0x20


class DescriptorError(TactableError):
    """A descriptor breaks the HID grammar, or its touch fields cannot be used; the message gives byte and value."""

    def __init__(self, problem: str, offset: int, value: int | None = None) -> None:
        self.problem = problem
        self.offset = offset
        self.value = value
        shown = "" if value is None else f" (value {value})"
        super().__init__(f"report descriptor, byte {offset}: {problem}{shown}")


@dataclass(frozen=True, slots=True)
class Field:
    """Position and meaning of one value; `bit` counts from the first of the report as sent, with its ID byte."""

    report_id: int
    bit: int
    size_bits: int
    logical_minimum: int
    logical_maximum: int
    physical_minimum: int
    physical_maximum: int
    unit: int
    unit_exponent: int

    @property
    def is_signed(self) -> bool:
        """Whether the value is two's complement: HID says so by a negative logical minimum."""
        return self.logical_minimum < 0

    @property
    def extent_mm(self) -> float | None:
        """Physical length of the logical range in millimetres, `None` where the device states none."""
        millimetres = _MILLIMETRES_PER_UNIT.get(self.unit & 0x0F)
        # Five vendors write 0x33, inches cubed, for inches: any power of length on an axis is taken as a length.
        is_length = self.unit & 0xF0 != 0 and self.unit >> 8 == 0
        extent = self.physical_maximum - self.physical_minimum
        if millimetres is None or not is_length or extent <= 0:
            return None
        return extent * millimetres * 10.0**self.unit_exponent


class FieldUse(NamedTuple):
    """A field a main item declares: its usage, the byte of the item, how many fields the item declares.

    In `field` the bit counts without the report ID: whether there is one is known at the end.
    """

    usage: int
    offset: int
    report_count: int
    is_stylus: bool
    field: Field


@dataclass(slots=True)
class Application:
    """One application collection: its usage, its input fields by report ID, its feature fields, in order."""

    usage: int
    inputs: dict[int, list[FieldUse]] = field(default_factory=dict)
    features: list[FieldUse] = field(default_factory=list)


@dataclass(slots=True)
class Declarations:
    """The declared fields of the wanted usages."""

    applications: list[Application] = field(default_factory=list)
    features: list[FieldUse] = field(default_factory=list)
    uses_report_ids: bool = False


def read_declarations(
    descriptor: bytes, input_usages: Sequence[int], feature_usages: Sequence[int], constant_usage: int
) -> Declarations:
    """Every input and feature field with one of the usages (page << 16 | usage).

    Inputs count where they hold a value: variable and absolute, of `constant_usage` also where they are called
    constant. Time is linear in the descriptor's length. Raises `DescriptorError`.
    """
    if not 0 < len(descriptor) <= MAXIMUM_DESCRIPTOR_BYTES:
        raise DescriptorError(f"length outside 1..{MAXIMUM_DESCRIPTOR_BYTES} bytes", 0, len(descriptor))
    parser = _Parser(sorted(input_usages), sorted(feature_usages), constant_usage)
    for item in _items(descriptor):
        parser.read_item(item)
    parser.check_end(len(descriptor))
    return parser.declarations


class _Item(NamedTuple):
    offset: int
    kind: int
    tag: int
    data: bytes

    @property
    def unsigned(self) -> int:
        return int.from_bytes(self.data, "little")

    @property
    def signed(self) -> int:
        return int.from_bytes(self.data, "little", signed=True)


def _items(descriptor: bytes) -> Iterator[_Item]:
    """Short items in order; long items are skipped, because HID defines none."""
    offset = 0
    while offset < len(descriptor):
        prefix = descriptor[offset]
        size = (0, 1, 2, 4)[prefix & 3]
        if prefix == _LONG_ITEM:
            size = 2 + (descriptor[offset + 1] if offset + 1 < len(descriptor) else 0)
        end = offset + 1 + size
        if end > len(descriptor):
            raise DescriptorError("item cut off by the end", offset, prefix)
        if prefix != _LONG_ITEM:
            yield _Item(offset, prefix >> 2 & 3, prefix >> 4, descriptor[offset + 1 : end])
        offset = end


@dataclass(slots=True)
class _Globals:
    usage_page: int = 0
    logical_minimum: int = 0
    logical_maximum: bytes = b""
    physical_minimum: int = 0
    physical_maximum: bytes = b""
    unit_exponent: int = 0
    unit: int = 0
    report_size: int = 0
    report_id: int = 0
    report_count: int = 0


class _UsageRange(NamedTuple):
    page: int | None
    first: int
    last: int


@dataclass(slots=True)
class _Locals:
    usages: list[_UsageRange] = field(default_factory=list)
    range_start: _Item | None = None


class _Collection(NamedTuple):
    application: Application | None
    is_stylus: bool


class _Parser:
    """The item state table of HID: globals persist, locals end with each main item."""

    def __init__(self, input_usages: list[int], feature_usages: list[int], constant_usage: int) -> None:
        self.declarations = Declarations()
        self._input_usages = input_usages
        self._feature_usages = feature_usages
        self._constant_usage = constant_usage
        self._bits: dict[tuple[int, int], int] = {}  # by main item tag and report ID
        self._globals = _Globals()
        self._pushed: list[_Globals] = []
        self._locals = _Locals()
        self._collections: list[_Collection] = []

    def read_item(self, item: _Item) -> None:
        if item.kind == _GLOBAL:
            self._read_global(item)
        elif item.kind == _LOCAL:
            self._read_local(item)
        elif item.kind == _MAIN:
            self._read_main(item)
            self._locals = _Locals()

    def check_end(self, offset: int) -> None:
        if self._collections:
            raise DescriptorError("ends inside open collections", offset, len(self._collections))

    def _read_global(self, item: _Item) -> None:
        match item.tag:
            case 0x8:
                self._globals.report_id = self._report_id(item)
            case 0xA:
                self._push(item)
            case 0xB:
                self._pop(item)
            case _ if item.tag in _GLOBAL_VALUES:
                name, value_of = _GLOBAL_VALUES[item.tag]
                setattr(self._globals, name, value_of(item))
            case _:
                raise DescriptorError("unknown global item", item.offset, item.tag)

    def _report_id(self, item: _Item) -> int:
        if not 1 <= item.unsigned <= 255:
            raise DescriptorError("report ID outside 1..255", item.offset, item.unsigned)
        self.declarations.uses_report_ids = True
        return item.unsigned

    def _push(self, item: _Item) -> None:
        if len(self._pushed) >= MAXIMUM_DEPTH:
            raise DescriptorError("too many states pushed", item.offset, len(self._pushed) + 1)
        self._pushed.append(replace(self._globals))

    def _pop(self, item: _Item) -> None:
        if not self._pushed:
            raise DescriptorError("Pop without Push", item.offset)
        self._globals = self._pushed.pop()

    def _read_local(self, item: _Item) -> None:
        match item.tag:
            case 0x0:
                self._add_usages(item, item)
            case 0x1:
                self._locals.range_start = item
            case 0x2 if self._locals.range_start is not None:
                self._add_usages(self._locals.range_start, item)
                self._locals.range_start = None
            case 0xA:
                raise DescriptorError("a delimiter, which no touch device has", item.offset, item.unsigned)

    def _add_usages(self, first: _Item, last: _Item) -> None:
        """A 4-byte usage carries its page; a shorter one takes the page in force at the main item."""
        page = first.unsigned >> 16 if len(first.data) == 4 else None
        self._locals.usages.append(_UsageRange(page, first.unsigned & 0xFFFF, last.unsigned & 0xFFFF))

    def _read_main(self, item: _Item) -> None:
        match item.tag:
            case 0x8 | 0x9 | 0xB:
                self._read_fields(item)
            case 0xA:
                self._open_collection(item)
            case 0xC if not self._collections:
                raise DescriptorError("End Collection without Collection", item.offset)
            case 0xC:
                self._collections.pop()

    def _open_collection(self, item: _Item) -> None:
        if len(self._collections) >= MAXIMUM_DEPTH:
            raise DescriptorError("collections nested too deep", item.offset, len(self._collections) + 1)
        outer = self._collections[-1] if self._collections else _Collection(None, is_stylus=False)
        usage = self._ranges()[0][0] if self._locals.usages else 0
        application = outer.application
        if item.unsigned & 0xFF == _APPLICATION_COLLECTION:
            application = Application(usage)
            self.declarations.applications.append(application)
        self._collections.append(_Collection(application, outer.is_stylus or usage == _STYLUS))

    def _ranges(self) -> list[tuple[int, int]]:
        """First and last usage of each range given, page included."""
        pages = (self._globals.usage_page if usages.page is None else usages.page for usages in self._locals.usages)
        return [
            (page << 16 | usages.first, page << 16 | usages.last)
            for page, usages in zip(pages, self._locals.usages, strict=True)
        ]

    def _read_fields(self, item: _Item) -> None:
        key = (item.tag, self._globals.report_id)
        start = self._bits.get(key, 0)
        end = start + self._globals.report_size * self._globals.report_count
        if end > MAXIMUM_REPORT_BITS:
            raise DescriptorError(f"report longer than {MAXIMUM_REPORT_BITS} bits", item.offset, end)
        self._bits[key] = end
        application = self._collections[-1].application if self._collections else None
        if item.tag == _FEATURE:
            uses = self._uses(item, start, self._feature_usages)
            self.declarations.features += uses
            if application is not None:
                application.features += uses
        elif item.tag == _INPUT and application is not None:
            uses = self._uses(item, start, self._input_usages)
            values = [use for use in uses if self._holds_value(use, item.unsigned)]
            application.inputs.setdefault(self._globals.report_id, []).extend(values)

    def _holds_value(self, use: FieldUse, flags: int) -> bool:
        is_absolute_variable = flags & (_VARIABLE | _RELATIVE) == _VARIABLE
        return is_absolute_variable or (use.usage == self._constant_usage and flags & _CONSTANT != 0)

    def _uses(self, item: _Item, start: int, wanted: list[int]) -> list[FieldUse]:
        """Fields of one main item that have a wanted usage, in order.

        Of a usage given twice in a row (14 devices send X, X, Y, Y) or repeated to fill the count, the first: it is
        the touch point, the others are the centre. Usages beyond the count have no field.
        """
        uses: list[FieldUse] = []
        index = 0
        previous = -1
        for first, last in self._ranges():
            position = bisect_left(wanted, first)
            while position < len(wanted) and wanted[position] <= last:
                place = index + wanted[position] - first
                if place < self._globals.report_count and wanted[position] != previous:
                    uses.append(self._use(wanted[position], item, start, place))
                position += 1
            previous = last
            index += max(1, last - first + 1)
        return uses

    def _use(self, usage: int, item: _Item, start: int, place: int) -> FieldUse:
        state = self._globals
        declared = Field(
            report_id=state.report_id,
            bit=start + place * state.report_size,
            size_bits=state.report_size,
            logical_minimum=state.logical_minimum,
            logical_maximum=_maximum(state.logical_maximum, state.logical_minimum),
            physical_minimum=state.physical_minimum,
            physical_maximum=_maximum(state.physical_maximum, state.physical_minimum),
            unit=state.unit,
            unit_exponent=state.unit_exponent,
        )
        is_stylus = bool(self._collections) and self._collections[-1].is_stylus
        return FieldUse(usage, item.offset, state.report_count, is_stylus, declared)


def _bounded(item: _Item, what: str) -> int:
    if item.unsigned > MAXIMUM_REPORT_BITS:
        raise DescriptorError(f"{what} above {MAXIMUM_REPORT_BITS}", item.offset, item.unsigned)
    return item.unsigned


def _maximum(data: bytes, minimum: int) -> int:
    """A maximum is signed only beside a negative minimum: many devices write 0..255 as 15 00 25 ff."""
    return int.from_bytes(data, "little", signed=minimum < 0)


def _unit_exponent(value: int) -> int:
    """The exponent as a signed nibble; some devices write the same number as a byte (0xFE for -2)."""
    return (value & 0x0F ^ 0x08) - 0x08


_GLOBAL_VALUES: Mapping[int, tuple[str, Callable[[_Item], object]]] = {
    0x0: ("usage_page", lambda item: item.unsigned & 0xFFFF),
    0x1: ("logical_minimum", lambda item: item.signed),
    0x2: ("logical_maximum", lambda item: item.data),
    0x3: ("physical_minimum", lambda item: item.signed),
    0x4: ("physical_maximum", lambda item: item.data),
    0x5: ("unit_exponent", lambda item: _unit_exponent(item.unsigned)),
    0x6: ("unit", lambda item: item.unsigned),
    0x7: ("report_size", lambda item: _bounded(item, "report size")),
    0x9: ("report_count", lambda item: _bounded(item, "report count")),
}
"""The fields of _Globals that an item sets, by its tag."""
