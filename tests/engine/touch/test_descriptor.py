"""Laws of the report descriptor reader."""

import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from engine.touch import DescriptorError
from engine.touch.descriptor import SurfaceKind, read_surfaces
from engine.touch.sources.recording import read_recording
from tests.engine.shared_recordings import recording_params
from tests.engine.test_fuzz import Seed, time_device
from tests.engine.touch.descriptors import CERTIFIED as SCREEN
from tests.engine.touch.descriptors import application, finger


def test_layout_counts_bits_from_the_report_id_and_without_one_from_the_first_byte() -> None:
    (surface,) = read_surfaces(SCREEN)
    (report,) = surface.reports
    first, second = report.contacts
    assert (first.tip.bit, first.x.bit, first.y.bit, second.tip.bit) == (8, 24, 40, 56)
    assert (first.x.size_bits, first.x.logical_minimum, first.x.logical_maximum) == (16, 0, 1000)
    assert report.scan_time is not None and report.scan_time.bit == 104
    assert report.contact_count is not None and report.contact_count.bit == 120
    (plain,) = read_surfaces(application(finger(), report_id=None))
    assert (plain.uses_report_ids, plain.contacts[0].tip.bit) == (False, 0)


@pytest.mark.parametrize(
    ("items", "extent_mm"),
    [
        ("6511 550e", 200.0),  # 2000 times 10^-2 cm
        ("6513 55fe", 508.0),  # 2000 times 10^-2 inch, the exponent written as a byte
        ("6533 550d", 50.8),  # inches "cubed", as five vendors write inches
        ("6514 550e", None),  # degrees
        ("6500 5500", None),  # no unit
        ("6511 550e 4500", None),  # no physical range
    ],
)
def test_extent_follows_unit_and_exponent(items: str, extent_mm: float | None) -> None:
    descriptor = application(finger()).replace(bytes.fromhex("6511 550e"), bytes.fromhex(items))
    (surface,) = read_surfaces(descriptor)
    assert surface.x.extent_mm == (extent_mm if extent_mm is None else pytest.approx(extent_mm))


def test_features_are_found_in_their_reports() -> None:
    (surface,) = read_surfaces(SCREEN)
    assert surface.is_win8
    maximum = surface.contact_count_maximum
    assert maximum is not None and (maximum.report_id, maximum.logical_maximum) == (2, 5)
    blob_of_another_size = SCREEN.replace(bytes.fromhex("960001"), bytes.fromhex("964000"))
    (surface,) = read_surfaces(blob_of_another_size)
    assert not surface.is_win8


def test_a_surface_that_cannot_be_read_is_left_out_beside_one_that_can_with_the_reason() -> None:
    useless, refused = application(finger()).replace(bytes.fromhex("26e803"), bytes.fromhex("2500")), list[Any]()
    (surface,) = read_surfaces(useless + SCREEN, refused)
    assert surface.report_id == 1
    assert [error.offset > 0 and "not below its maximum" in str(error) for error in refused] == [True]


def test_touch_and_transducer_index_are_read_where_tip_switch_and_contact_id_are_not_given() -> None:
    plain, bar = application(finger()), application(finger(flags="0933 0932").replace(b"\x09\x51", b"\x09\x38"))
    assert read_surfaces(bar) == read_surfaces(plain)
    both = application(finger(flags="0933 0942"))
    assert read_surfaces(both)[0].contacts[0].tip.bit == 8 + 1


def test_fingers_of_an_application_come_without_its_pens() -> None:
    (surface,) = read_surfaces(application(finger(collection=0x20), finger()))
    assert len(surface.contacts) == 1 and surface.contacts[0].tip.bit == 56
    (pens,) = read_surfaces(application(finger(collection=0x20)))
    assert pens.is_stylus and not surface.is_stylus


def test_a_relative_position_is_no_surface_of_a_doubled_one_the_first_counts_and_constant_ids_are_read() -> None:
    def changed(before: str, after: str) -> bytes:
        return application(finger().replace(bytes.fromhex(before), bytes.fromhex(after)))

    assert read_surfaces(changed("0930 8102", "0930 8106")) == ()
    (surface,) = read_surfaces(changed("0930 8102 0931 8102", "9504 0930 0930 0931 0931 8102 9501"))
    assert (surface.x.bit, surface.y.bit) == (24, 56)
    (surface,) = read_surfaces(changed("25ff 8102", "25ff 8103"))
    assert surface.has_contact_ids


@pytest.mark.parametrize(
    "variant",
    [
        bytes.fromhex("fe03aa010203") + SCREEN,  # a long item is skipped
        SCREEN.replace(  # Pop restores every global
            bytes.fromhex("0501 26e803"),
            bytes.fromhex("a4 057f 1505 2506 3507 4508 5509 650a 750b 950c b4 0501 26e803"),
            1,
        ),
    ],
)
def test_long_items_and_saved_globals_change_nothing(variant: bytes) -> None:
    assert variant != SCREEN
    assert read_surfaces(variant) == read_surfaces(SCREEN)


def test_a_maximum_is_signed_only_beside_a_negative_minimum() -> None:
    (unsigned,) = read_surfaces(SCREEN.replace(bytes.fromhex("26e803"), bytes.fromhex("26ffff")))
    (signed,) = read_surfaces(SCREEN.replace(bytes.fromhex("26e803"), bytes.fromhex("160080 26ff7f")))
    assert (unsigned.x.logical_maximum, unsigned.x.is_signed) == (65535, False)
    assert (signed.x.logical_minimum, signed.x.logical_maximum, signed.x.is_signed) == (-32768, 32767, True)


@pytest.mark.parametrize(
    ("descriptor", "offset", "problem"),
    [
        (b"", 0, "length outside"),
        (b"\x05" * 5000, 0, "length outside"),
        (b"\x05", 0, "cut off"),
        (b"\xc0", 0, "End Collection without Collection"),
        (SCREEN[:-1], len(SCREEN) - 1, "open collections"),
        (b"\xb4", 0, "Pop without Push"),
        (b"\xc4", 0, "unknown global item"),
        (b"\xa4" * 40, 32, "too many states"),
        (b"\xa1\x01" * 40, 64, "nested too deep"),
        (b"\x85\x00", 0, "report ID"),
        (b"\x86\x2c\x01", 0, "report ID"),
        (b"\x77\xff\xff\xff\xff", 0, "report size"),
        (b"\x97\xff\xff\xff\x7f", 0, "report count"),
        (b"\xa9\x00", 0, "delimiter"),
    ],
)
def test_broken_grammar_is_refused_with_its_place(descriptor: bytes, offset: int, problem: str) -> None:
    with pytest.raises(DescriptorError, match=problem) as caught:
        read_surfaces(descriptor)
    assert caught.value.offset == offset


@pytest.mark.parametrize(
    ("items", "instead", "problem"),
    [
        ("26e803", "1500 2500", "not below its maximum"),
        ("26e803", "150a 2505", "not below its maximum"),
        ("7510 0930", "7540 0930", "outside 1..32 bits"),
        ("7510 0930", "7500 0930", "outside 1..32 bits"),
        ("8501", "", "before the first report ID"),
    ],
)
def test_a_touch_field_that_cannot_be_read_is_refused(items: str, instead: str, problem: str) -> None:
    with pytest.raises(DescriptorError, match=problem):
        read_surfaces(SCREEN.replace(bytes.fromhex(items), bytes.fromhex(instead)))


@pytest.mark.parametrize("path", recording_params("touch", "*.hid"))
def test_every_recorded_digitizer_has_a_sensible_surface(path: Path) -> None:
    surfaces = read_surfaces(read_recording(path).descriptor)
    assert any(surface.has_contact_ids and not surface.is_stylus for surface in surfaces)
    for surface in surfaces:
        assert surface.kind in {SurfaceKind.TOUCH_SCREEN, SurfaceKind.TOUCH_PAD}
        assert surface.x.logical_maximum >= 500
        assert surface.x.extent_mm is None or 50.0 < surface.x.extent_mm < 2000.0
        assert 1 <= surface.contacts_per_report <= 20


@pytest.mark.parametrize("path", recording_params("malformed", "*.bin"))
def test_malformed_descriptors_are_settled_within_50_ms_and_50_mb(path: Path) -> None:
    device = Seed(path.read_bytes(), 0, 0, ())
    assert time_device(device.descriptor, device)[1] < 0.050
    tracemalloc.start()
    try:
        time_device(device.descriptor, device)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
