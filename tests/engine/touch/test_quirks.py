"""Laws of the quirk table."""

import pytest

from engine.touch import quirks


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
