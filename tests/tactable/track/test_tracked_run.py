"""A run with a sensor that stays: the loop passes samples on, and the drift of the simulated bar is found."""

import json
import shutil
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from engine.device import Device
from engine.device.values import restated
from engine.loop.observer import CommandRecord, LoopCounters
from engine.steady.cases import MeasuredFinger
from engine.table import Table
from engine.touch.sources.recording import Playback, write_recording
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.link_values import AccelerometerDescribed, Event
from firmware_link.protocol.link_errors import LinkError
from tactable.measure.board_sensor import BoardSensor
from tactable.measure.sensor import SensorError
from tactable.measure.simulated_bench import VirtualLine
from tactable.rig.accelerometer import EmulatedAccelerometer, SensedBoard
from tactable.rig.emulate import configuration_of
from tactable.run.live_run import Live, LiveOptions
from tactable.track.track_process import TrackedSensor
from tactable.track.tracker import Tracker
from tests.tactable.cli.in_process import run_here
from tests.tactable.rig.strokes import Stroke, make_recording
from tests.tactable.rig.test_emulate import emulator
from tests.tools.processes import started

BIT_RATE_HZ = 1_000_000
FINGER = 0.25
"""Of the length: where the simulated finger rests, and the digitizer tells it now and then."""
SENSOR = 0.97


def warm(device: Device, scale: float) -> Device:
    """The bar with Young's modulus multiplied."""
    return restated(
        replace(device, surface=replace(device.bar, youngs_modulus_pa=device.bar.youngs_modulus_pa * scale))
    )


def part_on(device: Device) -> EmulatedAccelerometer:
    length_m = device.bar.length_m
    return EmulatedAccelerometer(SENSOR * length_m, quiet=1, finger_m=FINGER * length_m)


class Following:
    """What the process beside a run does, in the process of the test: it hears the loop and observes its touches."""

    def __init__(self, device: Device, line: VirtualLine) -> None:
        self.device, self.line = device, line
        self.live: Live | None = None
        self.sensor: BoardSensor | None = None
        self.tracker: Tracker | None = None
        self.streams = 0
        self.told = list[list[MeasuredFinger]]()
        self.is_listening = True

    def fileno(self) -> int:
        return self.line.fileno()

    def poll(self) -> list[MeasuredFinger] | None:
        fingers = None if self.tracker is None else self.tracker.due_fingers()
        if fingers is not None:
            self.told.append(fingers)
        return fingers

    def begin_stream(self) -> None:
        self.streams += 1

    def take_event(self, event: Event) -> None:
        if isinstance(event, AccelerometerDescribed) and self.sensor is None and self.live is not None:
            board = self.live.capabilities, self.live.fit.scales
            self.sensor = BoardSensor(event, self.device, *board, self.line)
            at_m = SENSOR * self.device.bar.length_m
            self.tracker = Tracker(self.device, self.sensor, at_m, part_on(self.device).mass_kg)
        elif self.sensor is not None and self.tracker is not None:
            self.sensor.take_event(event)
            if (block := self.sensor.read()) is not None:
                self.tracker.take_block(block)

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:  # noqa: ARG002  # an Observer
        if self.tracker is not None:
            self.tracker.take_touches(record.time_ns, {touch.contact_id: touch.position_m for touch in record.touches})


def test_a_run_in_virtual_time_finds_the_drift_of_the_bar_that_it_plays(table: Table) -> None:
    device = table.device
    true = warm(device, 1.015)
    line = VirtualLine(SensedBoard(configuration_of(device), true, part_on(true), 1))
    following = Following(device, line)
    strokes = [Stroke(1 + 0.5 * tap, 1.3 + 0.5 * tap, FINGER, FINGER) for tap in range(12)]
    options = LiveOptions(bit_rate_hz=BIT_RATE_HZ, has_kernels=False)
    source = Playback(make_recording(strokes))
    live = following.live = Live(table, source, line, line, options, observer=following, measuring=following)
    live.run()
    assert following.streams == 1 and following.tracker is not None
    status, found = following.tracker.status(), following.tracker.estimate
    assert found is not None and status["simulated"] and status["windows"] + status["refused"] == 12
    assert status["refused"] <= 2
    assert found.drift == pytest.approx(0.015, abs=3 * found.drift_error)
    assert found.drift_error < 0.01


def test_a_board_without_an_accelerometer_ends_the_run_with_the_remedy(table: Table) -> None:
    line = VirtualLine(EmulatedFirmware(configuration_of(table.device)))
    source = Playback(make_recording([Stroke(0.1, 0.2, FINGER, FINGER)]))
    options = LiveOptions(bit_rate_hz=BIT_RATE_HZ, has_kernels=False)
    live = Live(table, source, line, line, options, measuring=Following(table.device, line))
    with pytest.raises(LinkError, match="no accelerometer: choose another sensor"):
        live.run()


@pytest.mark.parametrize(
    ("text", "is_of"),
    [
        ("board:35mm", ("board", 0.035, 2e-3)),
        ("board:35mm,mass=0.1g", ("board", 0.035, 1e-4)),
        ("samples@25%", ("samples", 0.25, 2e-3)),
        ("audio:USB,scale=98.1 m/s^2@35mm,mass=3g", ("audio:USB,scale=98.1 m/s^2", 0.035, 3e-3)),
    ],
)
def test_the_text_of_a_sensor_says_its_name_place_and_mass(
    table: Table, text: str, is_of: tuple[str, float, float]
) -> None:
    found = TrackedSensor.parse(text, table.device)
    at_m = is_of[1] * table.device.bar.length_m if "%" in text else is_of[1]
    assert found.name == is_of[0]
    assert (found.at_m.real, found.mass_kg) == pytest.approx((at_m, is_of[2]))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("board", "says no place; give board:35mm"),
        ("samples", "says no place"),
        ("board:9m", "off the surface"),
        ("board:35mm,mass=3N", "force"),
        ("@35mm", "says no place"),
    ],
)
def test_a_sensor_without_a_place_is_refused(table: Table, text: str, why: str) -> None:
    with pytest.raises(SensorError, match=f"^--track {text}: .*{why}"):
        TrackedSensor.parse(text, table.device)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--track", "board:35mm", "--no-watch"), "--no-watch: --track makes tables"),
        (("--page", "--page-at", "here:x"), "--page-at here:x: expected HOST:PORT"),
        (("--page", "--page-at", ":65536"), "--page-at :65536: expected HOST:PORT"),
    ],
)
def test_options_that_do_not_go_together_are_refused(tmp_path: Path, words: tuple[str, ...], why: str) -> None:
    done = run_here(tmp_path, "run", "bar.nc", "--touch", "simulated", "--port", "none", *words)
    assert done.returncode == 1 and done.stderr.startswith(f"tactable: {why}")


@pytest.mark.machine(stall_s=None)
def test_a_run_tells_the_drift_and_adopts_a_table_for_it(tmp_path: Path, click_table: Path) -> None:
    """From end to end: emulator, run, the process beside it, a table that it builds."""
    shutil.copyfile(click_table, tmp_path / "bar.nc")
    with Table.open(click_table) as table:
        device = table.device
    (tmp_path / "warm.toml").write_text(warm(device, 1.02).text, encoding="utf-8")
    strokes = [Stroke(1 + 0.6 * tap, 1.35 + 0.6 * tap, FINGER, FINGER) for tap in range(2_000)]
    write_recording(make_recording(strokes), tmp_path / "taps.hid")
    length_mm, port = 1e3 * device.bar.length_m, tmp_path / "port"
    sensor = f"at={SENSOR * length_mm}mm,finger={FINGER * length_mm}mm,quiet=1"
    emulate = ("--device", str(tmp_path / "warm.toml"), "--sensor", sensor, "--link", str(port))
    where = ("--touch", "taps.hid", "--port", str(port), "--bit-rate", str(BIT_RATE_HZ))
    words = ("bar.nc", *where, "--track", f"board:{SENSOR * length_mm}mm", "--reconnect", "--json")
    with emulator(tmp_path, *emulate) as emulated:
        assert emulated.line()
        with started(tmp_path, "run", *words) as process:
            assert process.stderr is not None
            said = ""
            while "verified and handed over" not in said:
                part = process.stderr.readline()
                assert part, said
                said += part
            process.send_signal(signal.SIGINT)
            summary = json.loads(process.communicate()[0])
    track: Mapping[str, object] = summary["track"]
    assert "table is re-scaled for a drift of +" in said and "SIMULATED" in said
    assert track["simulated"] is True and track["rescaled"]
