"""A run that plays on while its table is replaced, damaged, rolled back; in processes of their own."""

import json
import os
import select
import signal
import struct
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from base.files import identity_of
from engine.device import Device
from engine.loop.fast.fast_layout import FastRendering
from engine.table.history import roll_back
from engine.touch.sources.recording import write_recording
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.emulator_process import RunningEmulator
from tactable.run.table_watch import Messages, TableLook, Watched, _packed, _unpacked
from tactable.shipped import find_device
from tests.engine.loop.fast.scripts import varied_clicks
from tests.engine.loop.rig import BURSTS, Rig, recording_of, report
from tests.engine.made_table import LEVEL_DB, write_table
from tests.tactable.rig.strokes import Stroke, make_recording
from tests.tactable.rules import HELD
from tests.tools.processes import started

DEVICE = find_device("reference-a")


def write(path: Path, response: float, device: Device = DEVICE) -> None:
    """A table whose bar answers so much more than another: the drive for a level is so much weaker."""
    write_table(path, device, response=response)


Drive = tuple[float, float] | None


class Run:
    """`tactable run` with a finger that rests, as long as it is wanted."""

    def __init__(self, folder: Path, emulator: RunningEmulator) -> None:
        self.emulator, self.path = emulator, folder / "bar.nc"
        write(self.path, 1.0)
        (folder / "held.toml").write_text(HELD, encoding="utf-8")
        write_recording(make_recording((Stroke(0.0, 600.0, 0.5, 0.5),)), folder / "resting.hid")
        words = ["bar.nc", "--touch", "resting.hid", "--port", emulator.stable_port, "--rules", "held.toml"]
        self.process = started(folder, "run", *words, "--reconnect", "--json")
        self.first = self.wait_for_other_than(None)

    def wait_for_other_than(self, drive: Drive) -> Drive:
        """Until the firmware drives something else than this; nothing else ends it but the run."""
        while (found := self.drive()) in (None, drive):
            self.look_alive()
        return found

    def wait_for(self, drive: Drive) -> None:
        """Until the firmware drives this."""
        while self.drive() != drive:
            self.look_alive()

    def look_alive(self) -> None:
        assert self.process.poll() is None, self.process.stderr and self.process.stderr.read()
        time.sleep(0.05)

    def drive(self) -> Drive:
        """Frequency and amplitude of the first actuator in the last SET that sounds; None before the first."""
        first = [event.channels[0] for event in self.emulator.log().events if event.cause is Cause.SET]
        sounding = [(each.frequency_hz, each.amplitude) for each in first if each.amplitude]
        return sounding[-1] if sounding else None

    def say_until(self, words: str) -> str:
        assert self.process.stderr is not None
        said = ""
        while words not in said:
            line = self.process.stderr.readline()
            assert line, said
            said += line
        return said

    def end(self) -> dict[str, object]:
        self.process.send_signal(signal.SIGINT)
        told, _ = self.process.communicate()
        assert self.process.returncode == 0
        return dict(json.loads(told))


@pytest.mark.machine(stall_s=None)
def test_a_run_changes_over_to_each_new_table_and_back_and_outlives_the_process_that_looks_for_them(
    tmp_path: Path, emulator: RunningEmulator
) -> None:
    run = Run(tmp_path, emulator)
    write(run.path, 2.0)
    second = run.wait_for_other_than(run.first)
    write(run.path, 1.5)
    run.wait_for_other_than(second)
    roll_back(run.path)
    run.wait_for(second)
    words = ["pgrep", "-P", str(run.process.pid), "-f", "base.child tactable.run.table_watch"]
    os.kill(int(subprocess.run(words, capture_output=True, check=True).stdout), signal.SIGKILL)
    run.say_until("no longer watched for")
    assert run.drive() == second, "the run goes on with the table that it has"
    assert run.end()["changes_of_table"] == 3


def test_each_new_table_is_taken_once_and_one_that_fails_a_check_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, capabilities = tmp_path / "bar.nc", Rig(recording_of((0.0, report()))).session.link.capabilities
    write(path, 1.0)
    assert capabilities is not None
    zones = tuple(zone.name for zone in DEVICE.zones)
    values = (BURSTS, capabilities, False, 1_000_000)
    look = TableLook(Watched(path, identity_of(path), zones, *values))
    assert look.take_new() is None
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "damaged").write_bytes(data)
    (tmp_path / "damaged").replace(path)
    assert look.take_new() is None
    assert "is corrupted" in capsys.readouterr().err
    write(path, 1.25, Device.parse(DEVICE.text.replace("count = 5", "count = 4"), "bar.toml"))
    assert look.take_new() is None
    assert "has zones I, II, III, IV" in capsys.readouterr().err
    path.unlink()
    assert look.take_new() is None
    write(path, 3.0)
    assert look.take_new() is not None
    assert look.take_new() is None
    assert not capsys.readouterr().err


def test_a_rendered_table_comes_over_the_pipe_as_it_was_and_without_a_copy() -> None:
    sent = Rig(recording_of((0.0, report())), effects=BURSTS, clicks=varied_clicks(DEVICE)).rendering
    packed = memoryview(bytearray(_packed(sent)[8:]))
    received = _unpacked(packed)
    assert isinstance(received, FastRendering) and sent.fast_table is not None and received.fast_table is not None
    for name in ("pair", "head", "weights", "amplitude"):
        ours, theirs = getattr(sent.fast_table, name), getattr(received.fast_table, name)
        assert (ours == theirs).all()
        assert np.shares_memory(theirs, np.frombuffer(packed, np.uint8))
        assert theirs.ctypes.data % theirs.itemsize == 0
    placement = sent.renderer.clicks.clicks[7].placement
    assert received.renderer.render(placement, LEVEL_DB, True) == sent.renderer.render(placement, LEVEL_DB, True)
    assert received.renderer.render(placement, LEVEL_DB) == sent.renderer.render(placement, LEVEL_DB)


@pytest.mark.parametrize("piece", [1, 7, 1000, 10**6])
def test_messages_come_whole_however_the_system_cuts_them(piece: int) -> None:
    sent = [b"a", bytes(100), bytes(range(256)) * 300]
    stream = b"".join(struct.pack("<Q", len(message)) + message for message in sent)
    reading, writing = os.pipe()
    messages, received = Messages(reading), list[bytes]()
    for start in range(0, len(stream), piece):
        left = stream[start : start + piece]
        while left:
            left = left[os.write(writing, left[:4096]) :]
            while select.select([reading], [], [], 0)[0]:
                message = messages.read()
                received += [] if message is None else [bytes(message)]
    assert received == sent
    assert messages.read() is None
    os.write(writing, b'{"error": "it failed"}\n')  # the last words of a child are no message
    os.close(writing)
    with pytest.raises(EOFError):
        messages.read()
    os.close(reading)
