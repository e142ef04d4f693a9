"""The commands around touch devices, on machines made up here."""

import json
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from engine.device import Device
from engine.touch import DigitizerError, open_digitizer
from engine.touch.descriptor import Surface
from engine.touch.digitizer import Contact, TouchFrame
from engine.touch.finger_tracker import TouchPosition
from engine.touch.sources.hid_discovery import HidSystem, find_digitizers
from engine.touch.sources.recording import Recording, Report, read_recording, write_recording
from firmware_link.host.serial_port import PortDescription
from tactable.audio.interfaces import Interface
from tactable.audio.names import AudioError
from tactable.cli.main import app
from tactable.cli.options import OptionError
from tactable.cli.touch import map_json
from tactable.digitizers.axis_map import FINGERTIP_MM, Stroke, digitizer_table, learn, learn_axis
from tactable.digitizers.record import learn_from_recording, learn_live
from tactable.doctor.layers import Layer
from tactable.doctor.ports import check_cards
from tactable.doctor.touch_check import Machine, examine
from tactable.rig.virtual_digitizer import DESCRIPTOR, X_MAXIMUM, Y_MAXIMUM
from tactable.shipped import DEMO_RECORDING, device_folder
from tests.engine.touch.descriptors import HYBRID, TOUCH_PAD, application, finger
from tests.engine.touch.sources.fake_hid import DESCRIPTOR as FAKE_DESCRIPTOR
from tests.engine.touch.sources.fake_hid import FakeMachine, touch_report
from tests.engine.touch.test_digitizer import NOBODY, Finger, hybrid
from tests.tactable.rig.strokes import Stroke as DrawnStroke
from tests.tactable.rig.strokes import make_recording
from tests.tools.virtual import VirtualClock

SURFACE = open_digitizer(DESCRIPTOR).surface
TOUCH_MM = 279.4
MS = 1_000_000


@dataclass
class Bench:
    """A machine made up, and the commands on it."""

    hid: FakeMachine
    ports: tuple[PortDescription, ...] = ()
    cards: tuple[Interface, ...] | None = ()

    def system(self) -> HidSystem:
        return self.hid.system()

    def machine(self) -> Machine:
        return Machine(self.system, lambda: None, lambda: self.ports, cards=self.find_cards)

    def find_cards(self) -> tuple[Interface, ...]:
        if self.cards is None:
            raise AudioError("sound cards need the library PortAudio: run `sudo apt install libportaudio2`")
        return self.cards

    def run(self, *words: str) -> Result:
        return CliRunner().invoke(app, words, obj=self.machine())

    def json(self, *words: str) -> Any:
        return json.loads(self.run(*words, "--json").stdout)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(FakeMachine(tmp_path))
    yield made
    made.hid.close()


# ---- list ------------------------------------------------------------------------------------------------


def test_list_shows_size_contacts_a_stable_name_what_is_simulated_and_why_a_device_cannot_be_used(bench: Bench) -> None:
    device = bench.hid.plug(serial_number="A1")
    bench.hid.plug("hidraw1", product_string="virtual bar (SIMULATED)")
    emulated = PortDescription("/dev/ttyACM1", "x", "emulated firmware (SIMULATED)")
    bench.ports = (PortDescription("/dev/ttyACM0", "/dev/serial/by-id/usb-bar", "bar driver"), emulated)
    listing = bench.json("list")
    row = listing["digitizers"][0]
    assert (row["name"], row["path"], row["stable_id"], row["usable"]) == ("Touch Bar", device.path, "A1", True)
    assert (row["width_mm"], row["height_mm"], row["contact_maximum"]) == (200.0, 200.0, 5)
    assert [each["simulated"] for each in listing["digitizers"]] == [False, True, True]
    assert listing["digitizers"][-1]["stable_id"] == "simulated"
    port, other = listing["serial_ports"]
    assert list(port.values()) == ["/dev/ttyACM0", "/dev/serial/by-id/usb-bar", "bar driver", False]
    assert other["simulated"]
    assert "Touch Bar" in bench.run("list").stdout
    bench.hid.plug("hidraw2", descriptor=b"\x05\x0d\x09")
    bench.hid.plug("hidraw3", vendor_id=0x056A)
    rows = bench.json("list")["digitizers"][2:]
    assert [row["usable"] for row in rows] == [False, False, True]
    assert "cut off" in rows[0]["problem"] and "Wacom" in rows[1]["problem"]


def test_sound_cards_are_listed_with_the_text_that_chooses_them_and_the_doctor_needs_none(bench: Bench) -> None:
    bench.cards = (Interface(3, "USB: (hw:1,0)", 2, 4, 44_100.0, 0.0087),)
    (check,) = check_cards(bench.find_cards)
    assert check.passed and all(part in check.finding for part in ("2 outputs", "4 inputs", "8.7 ms"))
    card, simulated = bench.json("list")["sound_cards"]
    assert (card["choose_by"], card["outputs"], card["inputs"]) == ("audio:USB: (hw:1,0)", 2, 4)
    assert (simulated["choose_by"], simulated["simulated"]) == ("audio:simulated", True)
    bench.cards = None
    assert any("libportaudio2" in problem for problem in bench.json("list")["problems"])
    (check,) = check_cards(bench.find_cards)
    assert not check.needed and "libportaudio2" in check.remedy


def test_every_surface_of_an_interface_is_listed_with_a_name_that_chooses_it(bench: Bench, tmp_path: Path) -> None:
    device = bench.hid.plug(descriptor=FAKE_DESCRIPTOR + application(finger(), report_id=0x38, usage=TOUCH_PAD))
    rows = bench.json("list")["digitizers"][:2]
    assert [row["surface"] for row in rows] == ["04f3:200a#01", "04f3:200a#38"]
    assert [(row["kind"], row["usable"]) for row in rows] == [("touch_screen", True), ("touch_pad", True)]
    assert all(row["stable_id"].endswith(row["surface"][-3:]) for row in rows)
    path = tmp_path / "two.hid"
    reports = tuple(Report(index, 0.008 * index, b"\x38\x01\x05\x64\x00\x64\x00") for index in range(4))
    write_recording(Recording("bar", 3, 0x04F3, 0x200A, device.descriptor, reports), path)
    for name, frames in ((str(path), 4), (f"{path}#38", 4), (f"{path}#01", 0)):
        result = bench.run("replay", name, "--json")
        assert json.loads(result.stdout)["touch_frames"] == frames
        assert ("reports 38 come" in result.stderr) == (frames == 0)


def test_the_input_node_is_named_where_only_a_kernel_driver_decodes_the_reports(bench: Bench) -> None:
    device = bench.hid.plug(vendor_id=0x056A)
    for number, axes in enumerate(("1000003", "260800000000003", "3")):  # a pen, slots, a pad's ring
        node = bench.hid.folder / "sys" / "hidraw0" / "device" / "input" / f"input{number}"
        (node / f"event{number + 4}").mkdir(parents=True)
        (node / "capabilities").mkdir()
        (node / "capabilities" / "abs").write_text(f"{axes}\n")
    assert "/dev/input/event5" in bench.json("list")["digitizers"][0]["problem"]
    (check,) = [check for check in examine(bench.machine()) if device.path in check.name]
    assert check.remedy == "use /dev/input/event5"
    with pytest.raises(DigitizerError, match=r"Wacom.*/dev/input/event5"):
        learn_live(bench.machine(), device.path, [None], print)


def test_a_machine_without_hidapi_still_lists_the_rest() -> None:
    def system() -> HidSystem:
        raise DigitizerError("hidapi is not installed: run `pip install hidapi`")

    machine = Machine(system, lambda: None, lambda: ())
    listing = json.loads(CliRunner().invoke(app, ["list", "--json"], obj=machine).stdout)
    assert [row["stable_id"] for row in listing["digitizers"]] == ["simulated"]
    assert "pip install hidapi" in listing["problems"][0]


# ---- record ----------------------------------------------------------------------------------------------


@dataclass
class Once:
    time_ns: int
    do: Callable[[], object]
    is_done: bool = False

    def next_ns(self) -> int | None:
        return None if self.is_done else self.time_ns

    def act(self, now_ns: int) -> None:
        if not self.is_done and now_ns >= self.time_ns:
            self.is_done = True
            self.do()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> VirtualClock:
    made = VirtualClock()
    monkeypatch.setattr("engine.loop.loop.SystemClock", lambda: made)
    return made


@pytest.mark.usefixtures("clock")
def test_what_is_recorded_is_read_back_report_for_report(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "bar.hid"
    missing = bench.run("record", "04f3:200a", "-o", str(path))
    assert isinstance(missing.exception, DigitizerError) and not path.exists()
    device = bench.hid.plug()
    reports = [touch_report((1, step, True)) for step in range(5)]
    bench.hid.send(device, *reports)
    summary = bench.json("record", "04f3:200a", "-o", str(path), "--seconds", "0.2")
    recording = read_recording(path)
    assert [report.data for report in recording.reports] == reports
    assert recording.reports[0].time_s == 0.0
    identity = (recording.name, recording.bus, recording.vendor_id, recording.product_id, recording.descriptor)
    assert identity == ("Touch Bar", 3, 0x04F3, 0x200A, device.descriptor)
    assert (summary["reports"], summary["recording"]) == (5, str(path))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_a_recording_with_a_whole_file(
    bench: Bench, tmp_path: Path, clock: VirtualClock, number: signal.Signals
) -> None:
    path = tmp_path / "bar.hid"

    def interrupt() -> None:
        assert not path.exists()
        signal.raise_signal(number)

    clock.actors.append(Once(clock.time_ns + 500 * MS, interrupt))
    reports = bench.json("record", "simulated", "-o", str(path))["reports"]
    assert 0 < reports == len(read_recording(path).reports) < len(read_recording(DEMO_RECORDING).reports)
    assert list(tmp_path.iterdir()) == [path]


def test_replayed_frames_are_one_object_a_line(bench: Bench) -> None:
    printed = bench.run("replay", str(DEMO_RECORDING), "--frames", "--json").output
    first, *others, last = [json.loads(line) for line in printed.split("\n")[:-1]]
    assert (len(others), last["contacts"]) == (690, [])
    assert first["contacts"] == [{"id": 0, "x": 1638, "y": 511, "tip": True, "palm": False}]
    assert (first["report"], first["t_s"]) == (0, 0.0)


def test_a_replay_releases_by_time_where_the_engine_does(bench: Bench, tmp_path: Path) -> None:
    recording, bar = tmp_path / "panel.hid", tmp_path / "bar.toml"
    rests = (Report(0, 0.0, hybrid(Finger(1), NOBODY, 1)),)
    write_recording(Recording("panel", 3, 0x1234, 1, HYBRID, rests), recording)
    text = (device_folder() / "reference-a.toml").read_text()
    bar.write_text(text.replace("[digitizer]", '[digitizer]\nsilence = "200 ms" #', 1))
    words = ("replay", str(recording), "--frames", "--json")
    alone, by_file = (
        [json.loads(line) for line in bench.run(*words, *more).output.splitlines()]
        for more in ((), ("--device", str(bar)))
    )
    assert by_file == [*alone, {"report": None, "t_s": 0.2, "contacts": []}]


# ---- doctor ----------------------------------------------------------------------------------------------


@pytest.fixture
def layers(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = [Layer(name, 40.0, 900.0, "", "") for name in ("host", "engine", "line for a click")]
    monkeypatch.setattr("tactable.doctor.layers.measure_layers", lambda _: measured)


@pytest.mark.usefixtures("layers")
def test_a_machine_that_is_well_passes(bench: Bench, tmp_path: Path) -> None:
    bench.hid.plug()
    port = tmp_path / "ttyACM0"
    port.touch()
    bench.ports = (PortDescription(str(port), "bar", "bar driver"),)
    result = bench.run("doctor")
    assert result.exit_code == 0
    assert "FAIL" not in result.stdout


@pytest.mark.usefixtures("layers")
def test_every_failed_check_has_its_remedy_and_the_exit_status_tells(bench: Bench) -> None:
    bench.ports = (PortDescription("/nowhere/ttyACM0", "bar", "bar driver"),)
    result = bench.run("doctor", "--json")
    assert result.exit_code == 1
    checks = {check["name"]: check for check in json.loads(result.stdout)}
    failed = {name for name, check in checks.items() if check["needed"] and not check["passed"]}
    assert failed == {"digitizer", "serial port /nowhere/ttyACM0"}
    assert all(check["remedy"] for check in checks.values() if not check["passed"])
    assert 'KERNEL=="ttyACM0", TAG+="uaccess"' in checks["serial port /nowhere/ttyACM0"]["remedy"]


def test_the_rule_is_printed_for_one_for_all_and_for_a_device_not_there(bench: Bench) -> None:
    bench.hid.plug("hidraw0")
    bench.hid.plug("hidraw1", product_id=0xBEEF)
    rule = 'SUBSYSTEM=="hidraw", KERNELS=="*:{}.*", TAG+="uaccess"'
    lines = bench.run("doctor", "--emit-udev").stdout.splitlines()
    assert [line for line in lines if not line.startswith("#")] == [rule.format("04F3:200A"), rule.format("04F3:BEEF")]
    assert rule.format("04F3:BEEF") in bench.run("doctor", "--emit-udev", "04f3:beef").stdout
    assert rule.format("1234:ABCD") in bench.run("doctor", "--emit-udev", "1234:abcd").stdout
    assert isinstance(bench.run("doctor", "--emit-udev", "bar").exception, DigitizerError)


def test_the_rules_of_a_serial_port_are_printed_with_those_of_digitizers(bench: Bench) -> None:
    bench.hid.plug()
    usb = PortDescription("/dev/ttyACM0", "bar-1", "bar driver", 0x16C0, 0x0483)
    bench.ports = (PortDescription("/dev/ttyS0", "/dev/ttyS0", "n/a"), usb)
    ignored = 'ATTRS{idVendor}=="16c0", ATTRS{idProduct}=="0483", ENV{ID_MM_DEVICE_IGNORE}="1"'
    for words in ((), ("bar-1",), ("/dev/ttyACM0",)):
        lines = bench.run("doctor", "--emit-udev", *words).stdout.splitlines()
        assert ignored in lines
        assert any("hidraw" in line for line in lines if line[0] != "#") == (not words)
    assert isinstance(bench.run("doctor", "--emit-udev", "/dev/ttyS0").exception, DigitizerError)


def test_doctor_opens_no_node_and_tells_the_command_that_helps_where_there_is_no_permission(bench: Bench) -> None:
    device = bench.hid.plug()
    (found,) = find_digitizers(bench.system())
    before = set(Path("/proc/self/fd").iterdir())
    examine(bench.machine())
    assert set(Path("/proc/self/fd").iterdir()) == before
    # Root may read everything; a node that is listed and gone cannot be read by anyone.
    Path(device.path).rename(device.path + "-gone")
    checks = examine(bench.machine())
    Path(device.path + "-gone").rename(device.path)
    (check,) = [check for check in checks if check.name.startswith("digitizer")]
    assert f"--emit-udev {found.number}" in check.remedy


# ---- map -------------------------------------------------------------------------------------------------


def drawn(start: float, stop: float, *, axis: str = "x", across: float = 0.5) -> Stroke:
    """A stroke over fractions of the touch area."""
    along = [start + (stop - start) * step / 20 for step in range(21)]
    maximum, other = (X_MAXIMUM, Y_MAXIMUM) if axis == "x" else (Y_MAXIMUM, X_MAXIMUM)
    values = tuple(round(place * maximum) for place in along)
    rest = (round(across * other),) * 21
    return Stroke(values, rest) if axis == "x" else Stroke(rest, values)


def without_size(surface: Surface) -> Surface:
    """The same surface of a device that states no size."""
    (report,) = surface.reports
    bare = [replace(each, x=replace(each.x, unit=0), y=replace(each.y, unit=0)) for each in report.contacts]
    return replace(surface, reports=(replace(report, contacts=tuple(bare)),))


margins_mm = st.floats(0, 60)


@settings(deadline=None)  # the machine may be busy
@given(margins_mm, margins_mm, st.booleans(), st.booleans())
def test_a_bar_drawn_whole_puts_its_ends_where_the_finger_was(
    before_mm: float, after_mm: float, flip: bool, knows_bar: bool
) -> None:
    """The touch area reaches beyond the bar by `before_mm` and `after_mm`."""
    ends = (before_mm / TOUCH_MM, 1 - after_mm / TOUCH_MM)
    bar_mm = TOUCH_MM - before_mm - after_mm
    stroke = drawn(1 - ends[0], 1 - ends[1]) if flip else drawn(*ends)
    learnt = learn_axis(SURFACE, stroke, bar_mm if knows_bar else None)
    assert (learnt.axis, learnt.flip) == ("x", flip)
    assert learnt.length_mm is not None
    for margin, beyond_mm in ((learnt.start_margin, before_mm), (learnt.end_margin, after_mm)):
        tolerance_mm = 1.05 * FINGERTIP_MM if min(before_mm, after_mm) <= FINGERTIP_MM + 0.1 else 0.1
        assert margin * learnt.length_mm == pytest.approx(-beyond_mm, abs=2 * tolerance_mm)
        assert margin <= 0 or margin * learnt.length_mm > FINGERTIP_MM


def test_a_touch_area_shorter_than_the_bar_leaves_margins_and_a_stroke_short_by_a_fingertip_none() -> None:
    learnt = learn_axis(SURFACE, drawn(0, 1), TOUCH_MM + 40)
    for margin in (learnt.start_margin, learnt.end_margin):
        assert margin == pytest.approx(20 / 319.4)
    assert "measure" in learnt.notes[0]
    # The finger leaves the touch area before the bar's start only: the end is where it was lifted.
    learnt = learn_axis(SURFACE, drawn(0, 0.999), TOUCH_MM + 40)
    assert learnt.margin_text(learnt.start_margin) == "20 mm"
    tip = FINGERTIP_MM / 2 / TOUCH_MM
    learnt = learn_axis(SURFACE, drawn(tip, 1 - tip), TOUCH_MM)
    assert (learnt.start_margin, learnt.end_margin, learnt.notes) == (0.0, 0.0, ())


@pytest.mark.parametrize("knows_size", [True, False])
def test_what_is_printed_is_what_a_device_file_reads(knows_size: bool) -> None:
    surface = SURFACE if knows_size else without_size(SURFACE)
    learnt = learn_axis(surface, drawn(1, 0), TOUCH_MM + 40)
    text = (device_folder() / "reference-a.toml").read_text().replace("279.4 mm", f"{TOUCH_MM + 40} mm")
    before, _, after = text.partition("[digitizer]")
    rest = after[after.index("\n[") :]
    own = replace(Device.parse(text, "test").touch_axis, silence_s=0.12, debounce_s=0.03)
    axis = Device.parse(f"{before}{digitizer_table(learnt, own)}\n{rest}", "test").touch_axis
    assert (axis.silence_s, axis.debounce_s) == (0.12, 0.03)
    assert (axis.axis, axis.flip) == ("x", True)
    assert axis.start_margin_m == pytest.approx(0.02 if knows_size else 0.0)
    assert map_json(learnt, own)["table"] == digitizer_table(learnt, own)


def test_the_longest_stroke_of_a_recording_counts_and_one_that_tells_no_axis_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DigitizerError, match="20 % of the touch area"):
        learn_axis(SURFACE, drawn(0.4, 0.6))
    with pytest.raises(DigitizerError, match="straight along"):
        learn_axis(without_size(SURFACE), Stroke((0, X_MAXIMUM), (0, Y_MAXIMUM)))
    strokes = (DrawnStroke(0.0, 0.5, 0.1, 0.3), DrawnStroke(0.2, 1.0, 0.99, 0.01), DrawnStroke(1.2, 1.5, 0.5, 0.9))
    recording, path = make_recording(strokes), tmp_path / "drawn.hid"
    write_recording(recording, path)
    learnt = learn_from_recording(path, [TOUCH_MM])
    assert (learnt.axis, learnt.flip, learnt.start_margin) == ("x", True, 0.0)
    write_recording(replace(recording, reports=()), path)
    with pytest.raises(DigitizerError, match="nothing was touched"):
        learn_from_recording(path, [None])


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("flips", [(False, False), (True, False), (False, True), (True, True)])
def test_a_plate_is_learnt_from_a_stroke_along_it_and_one_across_it(axis: str, flips: tuple[bool, bool]) -> None:
    """The touch area, swapped or not, reaches beyond the plate; then the ends of the strokes lie at its edges."""
    other = "y" if axis == "x" else "x"
    strokes = [
        drawn(*((0.94, 0.08) if flip else (0.08, 0.94)), axis=each)
        for each, flip in zip((axis, other), flips, strict=True)
    ]
    frames = [
        TouchFrame(k, contacts)
        for k, contacts in enumerate(
            each
            for stroke in (drawn(0.5, 0.7), *strokes)
            for each in (*[(Contact(1, x, y, True, True),) for x, y in zip(stroke.x, stroke.y, strict=True)], ())
        )
    ]
    digitizer, surface = open_digitizer(DESCRIPTOR), without_size(SURFACE)
    digitizer.surface = surface
    text = (device_folder() / "reference-p.toml").read_text()
    before, _, after = text.partition("[digitizer]")
    table = digitizer_table(learn(digitizer, frames, [300.0, 180.0]))
    device = Device.parse(f"{before}{table}\n{after[after.index(chr(10) + '[') :]}", "test")
    position = TouchPosition(device, surface)
    for stroke, ends_m in zip(strokes, ((0.0, 0.3), (0.0, 0.18)), strict=True):
        for at, end_m in ((0, ends_m[0]), (-1, ends_m[1])):
            at_m = position.position_m(Contact(1, stroke.x[at], stroke.y[at], True, True))
            side_m = at_m.real if stroke is strokes[0] else at_m.imag
            assert side_m == pytest.approx(end_m, abs=1e-4)
    with pytest.raises(DigitizerError, match="then one across"):
        learn(digitizer, frames[22:44], [300.0, 180.0])


def test_map_of_a_live_device_ends_with_the_stroke(bench: Bench) -> None:
    device = bench.hid.plug()
    places = [20 * step for step in range(51)]
    bench.hid.send(device, *[touch_report((1, x, True)) for x in places], touch_report((1, 1000, False)))
    learnt = bench.json("map", "04f3:200a")
    assert (learnt["axis"], learnt["flip"], learnt["logical_at_end"]) == ("x", False, 1000)
    assert learnt["table"].startswith("[digitizer]")


@pytest.mark.parametrize("has_table", [True, False])
def test_map_writes_what_it_learnt_into_the_device_file_and_leaves_the_rest(
    bench: Bench, tmp_path: Path, has_table: bool
) -> None:
    path, text = tmp_path / "bar.toml", (device_folder() / "reference-a.toml").read_text()
    before, table, after = text.partition("[digitizer]")
    rest = after[after.index("\n[") :]
    path.write_text(f'{before}{table}\naxis = "y"\n{rest}' if has_table else before + rest)
    kept = Device.read(path)
    bench.run("map", str(DEMO_RECORDING), "--device", str(path), "--write")
    written = Device.read(path)
    assert written.touch_axis.axis == "x"
    assert (written.bar, written.actuators, written.zones) == (kept.bar, kept.actuators, kept.zones)
    assert path.read_text().replace(before, "").count("[digitizer] # learned") == 1
    assert all(line in path.read_text() for line in (before + rest).splitlines())


def test_map_writes_into_no_shipped_device(bench: Bench) -> None:
    assert isinstance(bench.run("map", "simulated", "--device", "reference-a", "--write").exception, OptionError)
