"""Report descriptors written item by item, as a device's firmware would hold them."""

TOUCH_SCREEN, TOUCH_PAD, PEN = 0x04, 0x05, 0x02
BLOB = bytes.fromhex("8511 0600ff 09c5 150026ff00 7508 960001 b102")
CONTACT_COUNT = bytes.fromhex("050d 0954 1500 257f 7508 9501 8102")
SCAN_TIME = bytes.fromhex("050d 0956 1500 27ffff0000 7510 9501 8102")
COUNT_MAXIMUM_5 = bytes.fromhex("8502 050d 0955 1500 2505 7508 9501 b102")


def finger(*, flags: str = "0942 0932", collection: int = 0x22) -> bytes:
    """Six bytes: eight flag bits (usages of page 0x0D first), 8-bit contact id, 16-bit X and Y of 0..1000, 200 mm."""
    named = len(bytes.fromhex(flags)) // 2
    return (
        bytes([0x05, 0x0D, 0x09, collection, 0xA1, 0x02])
        + bytes.fromhex(f"{flags} 1500 2501 7501")
        + bytes([0x95, named, 0x81, 0x02, 0x95, 8 - named, 0x81, 0x03])
        + bytes.fromhex("7508 9501 0951 25ff 8102")
        + bytes.fromhex("0501 26e803 46d007 6511 550e 7510 0930 8102 0931 8102 6500 5500 4500 c0")
    )


def application(*parts: bytes, usage: int = TOUCH_SCREEN, report_id: int | None = 1) -> bytes:
    identity = b"" if report_id is None else bytes([0x85, report_id])
    return bytes([0x05, 0x0D, 0x09, usage, 0xA1, 0x01]) + identity + b"".join(parts) + b"\xc0"


HYBRID = application(finger(), finger(), CONTACT_COUNT, COUNT_MAXIMUM_5)
CERTIFIED = application(finger(), finger(), SCAN_TIME, CONTACT_COUNT, COUNT_MAXIMUM_5, BLOB)
SERIAL = application(finger(), COUNT_MAXIMUM_5)
