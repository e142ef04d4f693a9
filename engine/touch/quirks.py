"""How digitizers depart from the specification, by vendor and product: facts from the Linux hid-multitouch driver."""

from dataclasses import dataclass, replace
from enum import Enum


class Validity(Enum):
    """The flag that marks a contact slot of a report as used; other slots are skipped."""

    ALWAYS = "always"
    IN_RANGE = "in range"
    TIP = "tip"
    CONFIDENCE = "confidence"


class Key(Enum):
    """What identifies a contact from frame to frame."""

    CONTACT_ID = "contact id, any number"
    SLOT_IS_CONTACT_ID = "contact id, below the contact maximum"
    SLOT_IS_CONTACT_ID_MINUS_ONE = "contact id counted from 1, up to the contact maximum"
    SLOT_IS_CONTACT_NUMBER = "place of the contact in the frame"


@dataclass(frozen=True, slots=True)
class QuirkClass:
    """How to read the reports of one family of devices; the fields are switches of the kernel driver.

    `count_is_accurate`: slots beyond the contact count are stale.
    `unseen_means_up`: a contact that a frame does not mention has lifted.
    `ignores_duplicates`: of two slots with the same contact id in a frame, the first is right.
    `hovers`: In Range without Tip Switch is a hovering finger; without this switch it is ignored.
    `frame_may_be_empty`: a contact count of 0 with a new scan time is a frame of its own.
    `maximum_contacts`: replaces a wrong Contact Count Maximum of the device.
    `releases_when_silent`: it repeats a resting finger, so that silence is a lost release (MT_QUIRK_STICKY_FINGERS).
    """

    validity: Validity = Validity.ALWAYS
    key: Key = Key.CONTACT_ID
    count_is_accurate: bool = False
    unseen_means_up: bool = False
    ignores_duplicates: bool = False
    hovers: bool = False
    frame_may_be_empty: bool = False
    maximum_contacts: int | None = None
    releases_when_silent: bool = False


GENERIC = QuirkClass(count_is_accurate=True)
SERIAL = QuirkClass()
UNSEEN_MEANS_UP = QuirkClass(Validity.TIP, unseen_means_up=True)
CONFIDENCE = QuirkClass(Validity.CONFIDENCE)
CONFIDENCE_CONTACT_ID = QuirkClass(Validity.CONFIDENCE, Key.SLOT_IS_CONTACT_ID)
CONFIDENCE_MINUS_ONE = QuirkClass(Validity.CONFIDENCE, Key.SLOT_IS_CONTACT_ID_MINUS_ONE)
IN_RANGE_CONTACT_NUMBER = QuirkClass(Validity.IN_RANGE, Key.SLOT_IS_CONTACT_NUMBER)
DUAL_IN_RANGE_CONTACT_NUMBER = replace(IN_RANGE_CONTACT_NUMBER, maximum_contacts=2)
DUAL_IN_RANGE_CONTACT_ID = QuirkClass(Validity.IN_RANGE, Key.SLOT_IS_CONTACT_ID, maximum_contacts=2)
# Windows certifies panels that report a resting finger again and again; Linux releases one after 100 ms without.
WIN8 = QuirkClass(
    count_is_accurate=True, ignores_duplicates=True, hovers=True, frame_may_be_empty=True, releases_when_silent=True
)
WIN8_UNSEEN_MEANS_UP = replace(WIN8, validity=Validity.TIP, unseen_means_up=True)
EGALAX = QuirkClass(Validity.IN_RANGE, Key.SLOT_IS_CONTACT_ID)
APPLE_TOUCH_BAR = QuirkClass(key=Key.SLOT_IS_CONTACT_ID_MINUS_ONE, hovers=True, maximum_contacts=11)
EGALAX_SERIAL = QuirkClass(key=Key.SLOT_IS_CONTACT_ID)
FLATFROG = replace(UNSEEN_MEANS_UP, maximum_contacts=40)
GENERAL_TOUCH = QuirkClass(Validity.TIP, Key.SLOT_IS_CONTACT_ID, unseen_means_up=True)
GENERAL_TOUCH_TWO_FINGERS = replace(GENERAL_TOUCH, maximum_contacts=2)
GOOGLE = QuirkClass(key=Key.SLOT_IS_CONTACT_ID, count_is_accurate=True, hovers=True)
LG = QuirkClass(count_is_accurate=True, ignores_duplicates=True, hovers=True)
PANASONIC = replace(UNSEEN_MEANS_UP, maximum_contacts=4)
SMART = QuirkClass(count_is_accurate=True, ignores_duplicates=True)
THREE_M = replace(CONFIDENCE_CONTACT_ID, maximum_contacts=60)
TOPSEED = QuirkClass(maximum_contacts=2)
VTL = replace(GENERIC, releases_when_silent=True)

_ANY_CERTIFICATION = (False, True)
_PLAIN = (False,)
_WIN8 = (True,)

# (class, certifications it holds for, {vendor: products}). Facts of Linux 6.1, drivers/hid/hid-multitouch.c:
# its table tells devices with the certification blob from those without, and so does this one.
_FAMILIES: tuple[tuple[QuirkClass, tuple[bool, ...], dict[int, tuple[int, ...]]], ...] = (
    (APPLE_TOUCH_BAR, _PLAIN, {0x05AC: (0x8302,)}),  # of Linux 6.17
    (THREE_M, _PLAIN, {0x0596: (0x0500, 0x0502, 0x0506)}),
    (SERIAL, _PLAIN, {0x03EB: (0x2118, 0x211C), 0x03FC: (0x05D8,), 0x10C4: (0x81B9,)}),
    (
        UNSEEN_MEANS_UP,
        _PLAIN,
        {
            0x0603: (0x0600,),  # Novatek
            0x0FB8: (0x1109,),  # Wistron
            0x1477: (0x1006, 0x1007, 0x100E, 0x1021, 0x1022, 0x1023, 0x1024, 0x1025, 0x1026),  # Xiroku
            0x1AAD: (0x000F,),  # GoodTouch
            0x1E5E: (0x0313,),  # Touch International
            0x1FF7: (0x0013,),  # CVTouch
            0x222A: (0x0001,),  # Ilitek
            0x2247: (0x0001,),  # Chunghwa
            0x227D: (0x0709, 0x0A19),  # Unitec
            0x2453: (0x0100,),  # Baanto
            0x24B8: (0x0020, 0x0040),  # CJTouch
            0x2505: (0x0220,),  # XAT
            0x25B6: (0x0002,),  # Gametel
        },
    ),
    (UNSEEN_MEANS_UP, _WIN8, {0x046D: (0xBB00,), 0x1B96: (0x1B05,)}),
    (CONFIDENCE, _PLAIN, {0x0483: (0x3261,)}),
    (CONFIDENCE_CONTACT_ID, _PLAIN, {0x0408: (0x3001,)}),
    (CONFIDENCE_MINUS_ONE, _PLAIN, {0x0486: (0x0185, 0x0186), 0x062A: (0x7100,)}),
    (IN_RANGE_CONTACT_NUMBER, _PLAIN, {0x093A: (0x8001, 0x8002, 0x8003)}),
    (DUAL_IN_RANGE_CONTACT_NUMBER, _PLAIN, {0x2087: (0x0A01, 0x0F01)}),
    (DUAL_IN_RANGE_CONTACT_ID, _PLAIN, {0x2087: (0x0703,), 0x22ED: (0x1010,)}),
    (EGALAX, _PLAIN, {0x0EEF: (0x480D, 0x480E, 0x720C, 0x726B, 0x72A1, 0x72FA, 0x7302, 0xC002)}),
    (EGALAX, _ANY_CERTIFICATION, {0x0EEF: (0x72C4, 0x72D0)}),
    (EGALAX_SERIAL, _PLAIN, {0x0EEF: (0x7207, 0x7224, 0x722A, 0x725E, 0x7262, 0x72AA, 0x7349, 0x73F7, 0xA001, 0xC000)}),
    (FLATFROG, _PLAIN, {0x25B5: (0x0002,)}),
    (GENERAL_TOUCH_TWO_FINGERS, _PLAIN, {0x0DFC: (0x0003, 0x0101)}),
    (GENERAL_TOUCH, _PLAIN, {0x0DFC: (0x0100, 0x0102, 0x0106, 0x010A, 0xE100)}),
    (GOOGLE, _ANY_CERTIFICATION, {0x18D1: (0x5028,)}),
    (GOOGLE, _WIN8, {0x18D1: (0x5030,)}),
    (LG, _ANY_CERTIFICATION, {0x1FD2: (0x6007, 0x7010)}),
    (PANASONIC, _PLAIN, {0x04DA: (0x1044, 0x104D)}),
    (SMART, _PLAIN, {0x0B8C: (0x0092,)}),
    (TOPSEED, _PLAIN, {0x1784: (0x0016,)}),
    # Asus T304: a certified pad that keeps the plain rules; VTL and Honor panels likewise, but for their silence.
    (GENERIC, _WIN8, {0x0B05: (0x184A,)}),
    (VTL, _WIN8, {0x347D: (0x7853,), 0x35CC: (0x0104,)}),
    (replace(WIN8, releases_when_silent=False), _WIN8, {0x0416: (0xC168,)}),  # Winbond
    (WIN8_UNSEEN_MEANS_UP, _ANY_CERTIFICATION, {0x27C6: (0x01E8, 0x01E9)}),
    (WIN8_UNSEEN_MEANS_UP, _WIN8, {0x04F3: (0x32AE,), 0x17EF: (0x60FE, 0x61AE), 0x046D: (0xC548,)}),
)

_CLASSES = {
    (vendor_id, product_id, is_win8): quirk_class
    for quirk_class, certifications, products in _FAMILIES
    for vendor_id, product_ids in products.items()
    for product_id in product_ids
    for is_win8 in certifications
}

# Wacom's interfaces are pen displays and tablets under their own driver and mode switch; Linux keeps every one of
# them from its multi-touch driver by vendor, whatever the descriptor says.
_VENDORS_WITH_OWN_DRIVER = {0x056A: "Wacom"}


def quirks_for(vendor_id: int, product_id: int, *, is_win8: bool, is_serial: bool) -> QuirkClass:
    """Class of a device: its table entry, else the generic one.

    `is_win8`: it has the certification blob. `is_serial`: its reports carry one contact each; such a device
    unknown to the table sends the state of one contact per report, whatever count it adds.
    """
    listed = _CLASSES.get((vendor_id, product_id, is_win8))
    if listed is not None:
        return listed
    generic = WIN8 if is_win8 else GENERIC
    return replace(generic, count_is_accurate=False) if is_serial else generic


def vendor_with_own_driver(vendor_id: int) -> str | None:
    """Name of a vendor whose interfaces are not generic digitizers, `None` for all others."""
    return _VENDORS_WITH_OWN_DRIVER.get(vendor_id)
