"""The report descriptor and the reports of a virtual ten-finger touch screen that is as long as a bar. SIMULATED."""

from collections.abc import Sequence

NAME = "tactable virtual touch bar (SIMULATED)"
BUS, VENDOR_ID, PRODUCT_ID = 3, 0xFFFE, 0x7AB1  # BUS_USB; a vendor that no quirk names
X_MAXIMUM, Y_MAXIMUM = 16383, 1023  # as in the bytes below: 17 um a step along the bar
SLOTS = 5  # ten fingers take two reports, as on hybrid digitizers

_FINGER = bytes.fromhex(
    "05 0d 09 22 a1 02"  # finger, logical collection
    "09 42 15 00 25 01 75 01 95 01 81 02 75 07 81 03"  # tip switch, padding
    "09 51 25 0f 75 08 95 01 81 02"  # contact identifier
    "05 01 15 00 26 ff 3f 35 00 46 ea 0a 55 0e 65 11 75 10 09 30 81 02"  # X, 0..16383 = 27.94 cm
    "26 ff 03 46 7f 00 09 31 81 02"  # Y, 0..1023 = 1.27 cm
    "45 00 55 00 65 00 c0"
)


def descriptor_of(slots: int) -> bytes:
    """Descriptor of a touch screen of ten fingers whose reports have `slots` slots."""
    return (
        bytes.fromhex("05 0d 09 04 a1 01 85 01")  # touch screen, report 1
        + _FINGER * slots
        + bytes.fromhex(
            "05 0d 55 0c 66 01 10 47 ff ff 00 00 27 ff ff 00 00 75 10 95 01 09 56 81 02"  # scan time, 100 us
            "45 00 55 00 65 00 09 54 25 7f 75 08 81 02"  # contact count
            "85 02 09 55 25 0a 75 08 95 01 b1 02 c0"  # feature: contact count maximum
        )
    )


DESCRIPTOR = descriptor_of(SLOTS)


def report_of(fingers: Sequence[tuple[int, bool, float]], time_s: float, slots: int = SLOTS) -> bytes:
    """Report 1 with (finger, down, place) in each slot; a lifted finger is reported once without its tip."""
    filled = b"".join(
        bytes((down, number % 16))
        + round(place * X_MAXIMUM).to_bytes(2, "little")
        + (Y_MAXIMUM // 2).to_bytes(2, "little")
        for number, down, place in fingers[:slots]
    )
    scan_time = round(time_s * 10_000) % 65_536
    return b"\x01" + filled.ljust(6 * slots, b"\0") + scan_time.to_bytes(2, "little") + bytes((len(fingers),))
