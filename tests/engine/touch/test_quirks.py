"""Laws of the quirk table."""

from __future__ import annotations

import pytest

from engine.touch.quirks import (
    CONFIDENCE_MINUS_ONE,
    EGALAX,
    GENERIC,
    SERIAL,
    THREE_M,
    UNSEEN_MEANS_UP,
    WIN8,
    QuirkClass,
    quirks_for,
    vendor_with_own_driver,
)


@pytest.mark.parametrize(
    ("vendor_id", "product_id", "is_win8", "is_serial", "expected"),
    [
        (0x0596, 0x0500, False, False, THREE_M),
        (0x1FF7, 0x0013, False, False, UNSEEN_MEANS_UP),
        (0x0486, 0x0185, False, False, CONFIDENCE_MINUS_ONE),
        (0x10C4, 0x81B9, False, False, SERIAL),
        (0x0EEF, 0x72FA, False, False, EGALAX),
        (0xFFFE, 1, False, False, GENERIC),
        (0xFFFE, 1, True, False, WIN8),
        (0x0596, 0x0500, True, False, WIN8),  # certified, which its kin in the table is not
        (0xFFFE, 1, False, True, SERIAL),  # never has stale slots
    ],
)
def test_a_device_has_its_class_by_certification_then_by_number_then_by_slots(
    vendor_id: int, product_id: int, is_win8: bool, is_serial: bool, expected: QuirkClass
) -> None:
    assert quirks_for(vendor_id, product_id, is_win8=is_win8, is_serial=is_serial) == expected


def test_wacom_is_left_to_its_own_driver() -> None:
    assert vendor_with_own_driver(0x056A) == "Wacom"
    assert vendor_with_own_driver(0x0596) is None
