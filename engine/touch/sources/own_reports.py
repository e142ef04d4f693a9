"""Encodes contacts as reports of a touch screen of our own, for sources that are not HID devices.

So every source speaks reports: one digitizer assembles them all, and any source can be recorded and replayed.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from engine.touch.descriptor import Surface
from engine.touch.digitizer import Contact

MOST_CONTACTS = 32  # a descriptor of 4096 bytes, the most Linux takes, holds 41

TIP, CONFIDENT = 1, 2  # flags of a contact, its first byte: it touches; it is no palm
_REPORT_ID = b"\x01"
_SLOT = struct.Struct("<B3I")  # tip and confidence, contact id, X, Y
_32_BITS = 0xFFFF_FFFF  # the size of its fields, "75 20" in the descriptor
_FLAGS = bytes.fromhex("05 0d 09 22 a1 02  09 42 15 00 25 01 75 01 95 01 81 02  09 47 81 02  75 06 81 03")
_CONTACT_ID = bytes.fromhex("75 20 09 51 27 ff ff ff 7f 81 02")
_FINGER_END = bytes.fromhex("35 00 45 00 65 00 c0")
_COUNT = bytes.fromhex("05 0d 09 54 15 00 25 20 75 08 81 02")
_MAXIMUM = bytes.fromhex("85 02 09 55 26")
_END = bytes.fromhex("75 08 b1 02 c0")


@dataclass(frozen=True)
class Axis:
    """Logical range of an axis and its length, None where the device states none."""

    minimum: int
    maximum: int
    length_mm: float | None = None


def are_ours(surface: Surface) -> bool:
    """Whether a surface is that of `ContactReports`, whose sources state every lift: no panel has ids of 31 bits."""
    report, contact_id = surface.reports[0], surface.contacts[0].contact_id
    ids, counts = (field and field.logical_maximum for field in (contact_id, report.contact_count))
    return (ids, counts) == (0x7FFF_FFFF, MOST_CONTACTS)


class ContactReports:
    """A touch screen of up to `contacts` (1 to 32; 1: serial) a report, and `maximum_contacts` (1 to 250) in all."""

    def __init__(self, x: Axis, y: Axis, contacts: int, maximum_contacts: int) -> None:
        if not 1 <= contacts <= MOST_CONTACTS:
            raise ValueError(f"contacts is {contacts}; expected 1 to {MOST_CONTACTS}")
        self._axes = (x, y)
        self.contacts = contacts
        self.size_bytes = 2 + contacts * _SLOT.size
        self.descriptor = _descriptor(x, y, contacts, maximum_contacts)

    def encode(self, contacts: Sequence[Contact]) -> bytes:
        """One report of at most as many contacts as it carries; one that has lifted must be in it once, tip False."""
        slots = b"".join(
            _SLOT.pack(
                TIP * contact.tip | CONFIDENT * contact.confidence,
                contact.contact_id & _32_BITS,
                _on_axis(contact.x, self._axes[0]),
                _on_axis(contact.y, self._axes[1]),
            )
            for contact in contacts[: self.contacts]
        )
        count = bytes([min(len(contacts), self.contacts)])
        return _REPORT_ID + slots.ljust(self.contacts * _SLOT.size, b"\0") + count


def _on_axis(value: int, axis: Axis) -> int:
    """The value inside the range, as the 32 bits of the field."""
    return min(max(value, axis.minimum), axis.maximum) & _32_BITS


def _descriptor(x: Axis, y: Axis, contacts: int, maximum_contacts: int) -> bytes:
    finger = _FLAGS + _CONTACT_ID + b"\x05\x01" + _axis_items(0x30, x) + _axis_items(0x31, y) + _FINGER_END
    touch_screen = bytes.fromhex("05 0d 09 04 a1 01 85 01") + finger * contacts
    return touch_screen + _COUNT + _MAXIMUM + maximum_contacts.to_bytes(2, "little") + _END


def _axis_items(usage: int, axis: Axis) -> bytes:
    """Range, length in hundredths of a millimetre (centimetres with exponent -3) and the field."""
    physical = 0 if axis.length_mm is None else round(100 * axis.length_mm)
    unit = 0x00 if axis.length_mm is None else 0x11
    ranges = struct.pack("<BiBiBi", 0x17, axis.minimum, 0x27, axis.maximum, 0x47, physical)
    return ranges + bytes([0x35, 0x00, 0x55, 0x0D, 0x65, unit, 0x09, usage, 0x81, 0x02])
