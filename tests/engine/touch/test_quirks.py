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
    ("vendor_id", "product_id", "expected"),
    [
        (0x0596, 0x0500, THREE_M),
        (0x1FF7, 0x0013, UNSEEN_MEANS_UP),
        (0x0486, 0x0185, CONFIDENCE_MINUS_ONE),
        (0x10C4, 0x81B9, SERIAL),
        (0x0EEF, 0x72FA, EGALAX),
    ],
)
def test_listed_devices_have_their_class(vendor_id: int, product_id: int, expected: QuirkClass) -> None:
    assert quirks_for(vendor_id, product_id, is_win8=False, is_serial=False) is expected


def test_an_unknown_device_is_generic_by_certification() -> None:
    assert quirks_for(0xFFFE, 1, is_win8=False, is_serial=False) is GENERIC
    assert quirks_for(0xFFFE, 1, is_win8=True, is_serial=False) is WIN8


def test_a_certified_device_leaves_the_class_of_its_uncertified_kin() -> None:
    assert quirks_for(0x0596, 0x0500, is_win8=True, is_serial=False) is WIN8


def test_an_unknown_serial_device_never_has_stale_slots() -> None:
    assert quirks_for(0xFFFE, 1, is_win8=False, is_serial=True) == SERIAL


def test_wacom_is_left_to_its_own_driver() -> None:
    assert vendor_with_own_driver(0x056A) == "Wacom"
    assert vendor_with_own_driver(0x0596) is None
