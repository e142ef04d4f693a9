"""Laws of live digitizers: found, opened, read, lost and found again."""

import select
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from engine.touch import Digitizer, DigitizerError, TouchFrame, open_digitizer
from engine.touch.sources import LIFT_ALL, Source
from engine.touch.sources.hid_discovery import (
    RULE_FILE,
    find_digitizers,
    load_hid_system,
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


def test_without_the_module_hidraw_the_remedy_is_named() -> None:
    def import_module(name: str) -> object:
        if name not in installed:
            raise ImportError(name)
        return SimpleNamespace()

    installed = {"hidraw", "hid"}
    load_hid_system(import_module)
    installed.remove("hidraw")
    with pytest.raises(DigitizerError, match="pip install -U hidapi"):
        load_hid_system(import_module)


def test_a_chosen_surface_is_chosen_again_after_a_replug(machine: FakeMachine) -> None:
    pad = application(finger(), usage=TOUCH_PAD, report_id=0x0C)
    device = machine.plug(descriptor=DESCRIPTOR + pad)
    source = machine.open(f"{NUMBER}#0C")
    machine.unplug(device)
    assert source.read(0) == LIFT_ALL
    machine.plug("hidraw1", descriptor=device.descriptor)
    source.read(1000 * MS)
    assert source.report_id == source.device.report_id == 0x0C
    with pytest.raises(DigitizerError, match="'xy' is no report ID"):
        machine.open(f"{NUMBER}#xy")


def test_a_device_of_several_collections_is_found_once_and_other_devices_never(machine: FakeMachine) -> None:
    touch = machine.plug("hidraw0", usages=((0x0D, 0x04), (0x0D, 0x05), (0x01, 0x02)))
    machine.plug("hidraw1", usages=((0x01, 0x06), (0x0D, 0x02), (0xFF00, 0x04)))
    assert [device.path for device in find_digitizers(machine.system())] == [touch.path]


@pytest.mark.parametrize(("hid_id", "bus"), [("0018:000004F3:0000200A", 0x18), ("", 0x05), ("what?", 0x05)])
def test_what_hidapi_says_of_a_device_is_passed_on_but_the_bus_that_the_kernel_knows_better(
    machine: FakeMachine, hid_id: str, bus: int
) -> None:
    machine.plug(bus_type=2, hid_id=hid_id, serial_number=" A1 ")
    (device,) = find_digitizers(machine.system())
    assert (device.name, device.number, device.serial_number, device.bus) == ("Touch Bar", NUMBER, "A1", bus)
    assert device.port == "usb-0000:00:14.0-6/input0"


def test_a_digitizer_is_chosen_by_any_name_and_one_for_two_or_none_is_refused_by_choice(machine: FakeMachine) -> None:
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


def test_a_source_ends_with_its_close_and_with_an_unplug_where_it_does_not_wait(machine: FakeMachine) -> None:
    device = machine.plug()
    source, other = machine.open(NUMBER), machine.open(NUMBER, reconnect=False)
    for _ in range(2):  # a second close does nothing
        source.close()
        assert (source.ended, source.fileno(), source.read(0)) == (True, None, None)
    machine.unplug(device)
    assert (other.read(0), other.ended, other.next_time_ns()) == (None, True, None)


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


def test_another_descriptor_is_another_device(machine: FakeMachine) -> None:
    machine.plug()
    source = lose(machine, NUMBER)
    machine.plug("hidraw1", descriptor=DESCRIPTOR[:-12])
    assert source.read(1000 * MS) is None
    assert source.state is Connection.LOST
    assert "another device" in str(source.problem)


def drain(source: Source, digitizer: Digitizer, now_ns: int) -> TouchFrame | None:
    """A pass of the loop: all that is there, then the watchdog; the last frame."""
    last = None
    while (report := source.read(now_ns)) is not None:
        last = digitizer.expire(source.report_time_ns) or last
        last = digitizer.decode_report(report, source.report_time_ns) or last
    return digitizer.expire(source.source_time_ns(now_ns)) or last


@pytest.mark.parametrize(("bursts", "overflows"), [((RING - 1,), 0), ((RING,), 1), ((RING // 2 + 1,) * 2, 0)])
def test_a_full_ring_overflows_and_releases_all(machine: FakeMachine, bursts: tuple[int, ...], overflows: int) -> None:
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


def test_no_permission_prints_where_the_rule_goes_and_it_names_the_device_as_the_kernel_does(
    machine: FakeMachine,
) -> None:
    machine.plug()
    system = machine.system()
    said = str(refusal(find_digitizers(system)[0], PermissionError(13, "Permission denied")))
    assert RULE_FILE in said
    assert 'SUBSYSTEM=="hidraw", KERNELS=="*:04F3:200A.*", TAG+="uaccess"' in said
    assert (parse_number("04F3:200a"), parse_number("/dev/hidraw0")) == ((0x04F3, 0x200A), None)


def test_a_node_that_is_gone_again_says_what_to_do(machine: FakeMachine) -> None:
    machine.plug()
    (device,) = find_digitizers(machine.system())
    machine.close()
    with pytest.raises(DigitizerError, match="plug it in again"):
        HidrawSource(machine.system(), device)


def test_a_system_that_cannot_list_says_so(machine: FakeMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise OSError("udev is not there")

    monkeypatch.setattr(machine, "enumerate", refuse)
    with pytest.raises(DigitizerError, match="udev is not there"):
        find_digitizers(machine.system())
