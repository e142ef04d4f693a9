"""Laws of live digitizers: found, opened, read, lost and found again."""

from __future__ import annotations

import select
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.touch import Digitizer, DigitizerError, TouchFrame, open_digitizer
from engine.touch.sources import LIFT_ALL, Source
from engine.touch.sources.hid_discovery import (
    RULE_FILE,
    find_digitizers,
    parse_number,
    refusal,
    select_digitizer,
)
from engine.touch.sources.hidraw import Connection, HidrawSource, read_descriptor
from tests.engine.touch.descriptors import TOUCH_PAD, application, finger
from tests.engine.touch.sources.fake_hid import DESCRIPTOR, RING, FakeMachine, touch_report

MS = 1_000_000
NUMBER = "04f3:200a"


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[FakeMachine]:
    made = FakeMachine(tmp_path)
    yield made
    made.close()


# ---- finding ---------------------------------------------------------------------------------------------


def test_a_device_of_several_collections_is_found_once_and_other_devices_never(machine: FakeMachine) -> None:
    assert find_digitizers(machine.system()) == ()
    mouse, pen = bytes.fromhex("05 01 09 02 a1 01 c0"), bytes.fromhex("05 0d 09 02 a1 01 c0")
    touch = machine.plug("hidraw0", descriptor=mouse + DESCRIPTOR + application(finger(), usage=TOUCH_PAD, report_id=9))
    machine.plug("hidraw1", descriptor=mouse + pen)
    machine.plug("hidraw2", descriptor=b"")
    assert [device.path for device in find_digitizers(machine.system())] == [touch.path]


@pytest.mark.parametrize(
    ("hid_id", "number", "bus"),
    [("0018:000004F3:0000200A", NUMBER, 0x18), ("", "0000:0000", 0), ("what?", "0000:0000", 0)],
)
def test_a_device_is_described_as_the_kernel_knows_it(machine: FakeMachine, hid_id: str, number: str, bus: int) -> None:
    machine.plug(hid_id=hid_id, serial_number="A1", product_string="ELAN ELAN Touch Bar")
    (machine.folder / "sys" / "hidraw0" / "bInterfaceNumber").write_text("01\n")
    (device,) = find_digitizers(machine.system())
    assert (device.name, device.number, device.serial_number, device.bus) == ("ELAN Touch Bar", number, "A1", bus)
    assert (device.port, device.interface_number) == ("usb-0000:00:14.0-6/input0", 1)


def test_a_digitizer_is_chosen_by_any_of_its_names_and_one_for_two_or_none_is_refused_with_the_choice(
    machine: FakeMachine,
) -> None:
    device = machine.plug("hidraw0", serial_number="A1")
    machine.plug("hidraw1", product_id=0x200B, port="usb-2")
    found = find_digitizers(machine.system())
    for name in (device.path, "A1", NUMBER, NUMBER.upper()):
        assert select_digitizer(name, found).path == device.path
    assert select_digitizer("04f3:200b@usb-2", found).path.endswith("hidraw1")
    machine.plug("hidraw2", port="usb-3")
    found = find_digitizers(machine.system())
    with pytest.raises(DigitizerError, match=r"2 digitizers.*hidraw0, .*hidraw2"):
        select_digitizer(NUMBER, found)
    with pytest.raises(DigitizerError, match=r"no digitizer 'bar'.*04f3:200a@usb-3"):
        select_digitizer("bar", found)


def test_the_descriptor_is_read_without_permission_to_open(machine: FakeMachine) -> None:
    device = machine.plug()
    Path(device.path).chmod(0)
    system = machine.system()
    assert read_descriptor(system, find_digitizers(system)[0]) == DESCRIPTOR


# ---- reading a node --------------------------------------------------------------------------------------


def test_reports_come_in_order_with_index_and_time(machine: FakeMachine) -> None:
    device = machine.plug()
    source = machine.open(NUMBER)
    live: Source = source
    assert (live.name, live.vendor_id, live.product_id, live.descriptor) == ("Touch Bar", 0x04F3, 0x200A, DESCRIPTOR)
    assert live.read(5 * MS) is None
    reports = [touch_report((1, 100 * step, True)) for step in range(3)]
    machine.send(device, *reports)
    for index, report in enumerate(reports):
        assert live.read(7 * MS + index) == report
        assert (live.report_index, live.report_time_ns) == (index, 7 * MS + index)
    assert live.read(9 * MS) is None
    assert not live.ended
    assert live.next_time_ns() is None


def readable(source: Source) -> bool:
    descriptor = source.fileno()
    assert descriptor is not None
    return bool(select.select([descriptor], [], [], 0)[0])


def test_the_descriptor_to_wait_on_stays_the_same_over_a_replug(machine: FakeMachine) -> None:
    device = machine.plug()
    source = machine.open(NUMBER)
    number = source.fileno()
    assert not readable(source)
    machine.send(device, touch_report((1, 5, True)))
    assert readable(source)
    assert source.read(0) is not None
    machine.unplug(device)
    assert readable(source)
    assert source.read(1 * MS) == LIFT_ALL
    assert not readable(source)
    machine.send(machine.plug(), touch_report((1, 6, True)))
    assert source.read(2000 * MS) is not None
    assert (source.fileno(), source.state) == (number, Connection.CONNECTED)


def test_a_second_close_does_nothing_and_the_source_has_ended(machine: FakeMachine) -> None:
    machine.plug()
    source = machine.open(NUMBER)
    for _ in range(2):
        source.close()
        assert (source.ended, source.fileno(), source.read(0)) == (True, None, None)


# ---- unplug ----------------------------------------------------------------------------------------------


def test_an_unplug_ends_a_source_that_does_not_wait(machine: FakeMachine) -> None:
    device = machine.plug()
    source = machine.open(NUMBER, reconnect=False)
    machine.unplug(device)
    assert source.read(0) is None
    assert source.ended
    assert source.next_time_ns() is None


def test_a_lost_device_is_looked_for_less_and_less_often_and_said_to_be_lost(machine: FakeMachine) -> None:
    device = machine.plug()
    source = machine.open(NUMBER)
    machine.unplug(device)
    assert source.read(0) == LIFT_ALL
    times_ms = []
    for _ in range(6):
        assert (source.state, source.ended) == (Connection.LOST, False)
        due_ns = source.next_time_ns()
        assert due_ns is not None
        assert source.read(due_ns - 1) is None
        times_ms.append(due_ns // MS)
        assert source.read(due_ns) is None
    assert times_ms == [250, 750, 1750, 3750, 5750, 7750]
    assert "plug it in again" in str(source.problem)
    machine.plug("hidraw7")
    source.read(10_000 * MS)
    assert source.state is Connection.CONNECTED
    assert source.device.path.endswith("hidraw7")
    assert source.problem is None
    assert (source.counters.losses, source.counters.reconnects) == (1, 1)


def lose(machine: FakeMachine, name: str) -> HidrawSource:
    source = machine.open(name)
    machine.unplug(machine.plugged[source.device.path])
    assert source.read(0) == LIFT_ALL
    return source


def test_the_twin_of_a_lost_device_does_not_stand_in_for_it(machine: FakeMachine) -> None:
    machine.plug("hidraw0", port="usb-1")
    machine.plug("hidraw1", port="usb-2")
    source = lose(machine, f"{NUMBER}@usb-1")
    assert source.read(1000 * MS) is None
    assert source.state is Connection.LOST
    machine.plug("hidraw2", port="usb-1")
    source.read(9000 * MS)
    assert source.device.path.endswith("hidraw2")


def test_a_device_with_a_serial_number_is_known_at_any_port(machine: FakeMachine) -> None:
    machine.plug("hidraw0", serial_number="A1", port="usb-1")
    source = lose(machine, "A1")
    machine.plug("hidraw3", serial_number="B2", port="usb-1")
    machine.plug("hidraw4", serial_number="A1", port="usb-9")
    source.read(1000 * MS)
    assert source.device.path.endswith("hidraw4")


def test_another_descriptor_is_another_device(machine: FakeMachine) -> None:
    machine.plug()
    source = lose(machine, NUMBER)
    machine.plug("hidraw1", descriptor=DESCRIPTOR[:-12])
    assert source.read(1000 * MS) is None
    assert source.state is Connection.LOST
    assert "another device" in str(source.problem)


# ---- overflow --------------------------------------------------------------------------------------------


def drain(source: Source, digitizer: Digitizer, now_ns: int) -> TouchFrame | None:
    """A pass of the loop: all that is there, then the watchdog; the last frame."""
    last = None
    while (report := source.read(now_ns)) is not None:
        last = digitizer.expire(source.report_time_ns) or last
        last = digitizer.decode_report(report, source.report_time_ns) or last
    return digitizer.expire(source.source_time_ns(now_ns)) or last


@pytest.mark.parametrize(("bursts", "overflows"), [((RING - 1,), 0), ((RING,), 1), ((RING // 2 + 1,) * 2, 0)])
def test_a_full_ring_is_an_overflow_that_releases_everything(
    machine: FakeMachine, bursts: tuple[int, ...], overflows: int
) -> None:
    device = machine.plug()
    source, digitizer, frame = machine.open(NUMBER), open_digitizer(DESCRIPTOR), None
    for count in bursts:
        machine.send(device, *[touch_report((1, step, True), (2, step, True)) for step in range(count)])
        frame = drain(source, digitizer, 1000 * MS)
    assert frame is not None
    assert source.counters.overflows == overflows
    assert [contact.contact_id for contact in frame.contacts] == ([] if overflows else [1, 2])
    # The lift of 2 was lost with the overflow: what comes next tells of 1 alone.
    machine.send(device, touch_report((1, 9, True)))
    frame = drain(source, digitizer, 1008 * MS)
    assert frame is not None
    assert [contact.contact_id for contact in frame.contacts] == ([1] if overflows else [1, 2])
    assert source.clock_time_ns(source.report_time_ns) == 1008 * MS
    assert source.clock_time_ns(source.source_time_ns(1009 * MS)) == 1009 * MS


# ---- surfaces --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "report_id"), [(NUMBER, None), (f"{NUMBER}#01", 1), (f"{NUMBER}#0C", 12)])
def test_a_surface_is_chosen_by_its_report_also_after_a_replug(
    machine: FakeMachine, name: str, report_id: int | None
) -> None:
    device = machine.plug(descriptor=DESCRIPTOR + application(finger(), usage=TOUCH_PAD, report_id=0x0C))
    source = machine.open(name)
    machine.unplug(device)
    assert source.read(0) == LIFT_ALL
    machine.plug("hidraw1", descriptor=device.descriptor)
    source.read(1000 * MS)
    assert source.report_id == source.device.report_id == report_id
    with pytest.raises(DigitizerError, match="'xy' is no report ID"):
        machine.open(f"{NUMBER}#xy")


# ---- refusals --------------------------------------------------------------------------------------------


def test_no_permission_prints_where_the_rule_goes_and_it_names_the_device_as_the_kernel_does(
    machine: FakeMachine,
) -> None:
    machine.plug()
    said = str(refusal(find_digitizers(machine.system())[0], PermissionError(13, "Permission denied")))
    assert RULE_FILE in said
    assert 'SUBSYSTEM=="hidraw", KERNELS=="*:04F3:200A.*", TAG+="uaccess"' in said
    assert (parse_number("04F3:200a"), parse_number("/dev/hidraw0")) == ((0x04F3, 0x200A), None)


def test_a_node_that_cannot_be_opened_or_is_gone_again_says_what_to_do(machine: FakeMachine) -> None:
    device = machine.plug()
    (found,) = find_digitizers(machine.system())
    Path(device.path).rename(device.path + "-away")
    with pytest.raises(DigitizerError, match=r"No such file.*other programs"):
        machine.open(NUMBER)
    Path(device.path + "-away").rename(device.path)
    machine.close()
    with pytest.raises(DigitizerError, match="plug it in again"):
        HidrawSource(machine.system(), found)
