"""Touch screen to firmware through the drivers of a real kernel, in a guest; guest.py says what happens there."""

import pickle
import re
import shlex
import subprocess
import sys
import time
from fnmatch import fnmatchcase
from itertools import groupby
from pathlib import Path
from typing import TypeVar

import pytest

from engine.loop.observer import CommandRecord
from engine.touch.sources.hidraw import RING_SIZE
from engine.touch.sources.recording import Playback
from firmware_link.emulator.drive_log import Cause, DriveEvent, Outcome
from firmware_link.emulator.emulator_process import run_emulator
from firmware_link.host.serial_port import SerialPort
from tests.engine.made_table import state_index, states_of
from tests.engine.render.made_steady import MadeSteady
from tests.system.chain import BIT_RATE_HZ, DEVICE, ChainRun, driven_hz, is_silent, run_chain
from tests.system.guest import DEMO, HELD, SWEPT, TAP, Broken, Happened, KernelDevice

Result = TypeVar("Result")

pytestmark = pytest.mark.machine

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
# Only against a guest that hangs: it is done within a minute, on a crowded machine within 4.
GUEST_LIMIT_S = 600
# A sequence number is used again after 256 frames, which take more than 3 s.
SAME_SEQUENCE_NS = 2_000_000_000


class Guest:
    """The results of all scenarios by name; a broken scenario fails the tests that ask for it."""

    def __init__(self, results: dict[str, object], console: str) -> None:
        self._results = results
        self._console = console

    def result(self, name: str, kind: type[Result]) -> Result:
        found = self._results.get(name)
        assert not isinstance(found, Broken), f"{found.trace}\n{self._console}"
        assert isinstance(found, kind), f"{name} did not run\n{self._console}"
        return found


@pytest.fixture(scope="module")
def guest(tmp_path_factory: pytest.TempPathFactory) -> Guest:
    prepared = subprocess.run([HERE / "prepare.sh", "--check"], capture_output=True, text=True, check=False)
    if prepared.returncode:
        pytest.skip(prepared.stderr.strip())
    share = tmp_path_factory.mktemp("guest")
    command = shlex.join([sys.executable, "-c", "from tests.system.guest import main; main()", "/guest/results"])
    lines = ["export PATH=/usr/sbin:/usr/bin:/sbin:/bin PYTHONDONTWRITEBYTECODE=1", f"cd {shlex.quote(str(ROOT))}"]
    (share / "run.sh").write_text("\n".join([*lines, command, ""]), encoding="utf-8")
    boot: list[str | Path] = [HERE / "boot.sh", prepared.stdout.strip(), share, str(GUEST_LIMIT_S)]
    start_s = time.monotonic()
    done = subprocess.run(
        boot, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    console = f"{done.stdout}\nstatus {done.returncode} after {time.monotonic() - start_s:.0f} s"
    results = share / "results"
    assert results.exists(), console
    return Guest(pickle.loads(results.read_bytes()), console)


def play_beside() -> ChainRun:
    """The same recording without a kernel's drivers: played into the engine, to an emulator behind a pty."""
    with run_emulator() as emulator:
        return run_chain(Playback(DEMO), SerialPort(emulator.port, BIT_RATE_HZ))


def index_of(zone: int) -> int:
    return state_index(states_of(DEVICE, [zone]))


def time_ns(happened: Happened, event: DriveEvent) -> int:
    return happened.log.host_ns_at_device_zero + 1000 * event.device_time_us


def tap_us(happened: Happened) -> int:
    """Device time at which the firmware began the drive of the tap."""
    sounding = (event for event in happened.log.events if not is_silent(event))
    return next(event.device_time_us for event in sounding if event.channels[0].frequency_hz == 116.0)


def last_before(happened: Happened, note: str) -> DriveEvent:
    return [event for event in happened.log.events if time_ns(happened, event) < happened.notes[note]][-1]


def played_for(happened: Happened, change: CommandRecord) -> DriveEvent | None:
    """The firmware's change of drive by the command of a state; None where it was never sent, stale or no change."""
    since_ns = [(event, time_ns(happened, event) - change.time_ns) for event in happened.log.events]
    near = (event for event, passed_ns in since_ns if 0 <= passed_ns < SAME_SEQUENCE_NS and event.cause is Cause.SET)
    return next((event for event in near if event.sequence == change.drive_sequence), None)


def test_the_guest_renders_what_a_run_beside_it_renders_and_every_drive_reaches_the_firmware(guest: Guest) -> None:
    device, happened = guest.result("kernel_device", KernelDevice), guest.result("whole_chain", Happened)
    (run,), log = happened.runs, happened.log
    assert (device.driver, device.product_name) == ("hid-multitouch", DEMO.name)
    assert device.descriptor == DEMO.descriptor

    assert run.link_error is None
    assert run.states() == play_beside().states()
    assert len(run.states()) == 17

    assert run.counters.reports == run.counters.frames == len(DEMO.reports), "a report was lost"
    assert (happened.source.overflows, happened.source.losses) == (0, 0)
    outcomes = [frame.outcome for frame in log.received if frame.message == "SET"]
    assert len(outcomes) == run.link_counters.sent + run.link_counters.renewed, "a drive was lost"
    assert set(outcomes) <= {Outcome.ACCEPTED, Outcome.STALE, Outcome.REFUSED}
    assert outcomes.count(Outcome.ACCEPTED) == log.counters["applied"] > len(outcomes) / 2
    assert [log.counters[name] for name in ("crc", "framing", "length", "overrun")] == [0] * 4

    made = MadeSteady(DEVICE)
    felt = [(change, made.frequency_hz(change.placement)) for change in run.trace if change.placement is not None]
    played = [(event, hz) for change, hz in felt if (event := played_for(happened, change)) is not None]
    assert len(played) >= 6
    for event, hz in played:
        assert {channel.frequency_hz for channel in event.channels} == {hz}, "a drive is not that of its state"
    # In order, and without one only where the guest stalled so that the next took its place or it came too late; its
    # neighbours may then be of one frequency.
    wanted_hz, found_hz = [hz for hz, _ in groupby(hz for _, hz in felt)], driven_hz(log)
    rest_hz = iter(wanted_hz)
    assert all(hz in rest_hz for hz in found_hz), (found_hz, wanted_hz)
    stalled = run.link_counters.coalesced + len(outcomes) - outcomes.count(Outcome.ACCEPTED)
    assert len(wanted_hz) - len(found_hz) <= 2 * stalled, (found_hz, wanted_hz)

    assert is_silent(log.events[-1]), "a run that is stopped leaves the firmware silent and latched"
    assert (log.received[-1].message, log.received[-1].outcome) == ("STOP", Outcome.ACCEPTED)
    assert run.link_counters.acknowledged >= 2


def test_what_is_unplugged_is_silent_and_goes_on_when_it_is_back(guest: Guest) -> None:
    happened = guest.result("touch_screen_unplugged", Happened)
    (run,) = happened.runs
    assert run.link_error is None
    assert (happened.source.losses, happened.source.reconnects) == (1, 1)
    assert run.counters.reports == len(HELD.reports) + 1 + len(TAP.reports)  # LIFT_ALL stands for the loss
    assert run.states() == [index_of(0), 0, index_of(4), 0]
    assert driven_hz(happened.log) == [101.0, 116.0]
    before_tap = [event for event in happened.log.events if event.device_time_us < tap_us(happened)]
    assert is_silent(before_tap[-1])

    happened = guest.result("gadget_unplugged", Happened)
    first, second = happened.runs
    assert re.fullmatch(r"/dev/ttyACM\d+ is gone \(.+\): plug the device in and connect again", first.link_error or "")
    last = last_before(happened, "plugged in again")
    assert is_silent(last), "the firmware of a port that is gone falls silent by itself"
    # But for a guest that stalled at the last moment, so that the engine took the finger for gone.
    assert last.cause is Cause.LEASE_EXPIRED or first.trace[-1].placement is None
    assert second.link_error is None, "a port that is back is found by its stable id"
    assert first.states() == [index_of(0)]
    assert second.states()[-2:] == [index_of(4), 0]
    assert driven_hz(happened.log) == [101.0, 116.0]
    assert is_silent(happened.log.events[-1])


def test_an_overflow_is_counted_released_and_forgotten(guest: Guest) -> None:
    happened = guest.result("overflow", Happened)
    (run,) = happened.runs
    assert len(SWEPT.reports) > RING_SIZE
    assert happened.source.overflows == 1
    assert run.counters.reports == RING_SIZE + 1 + len(TAP.reports)  # LIFT_ALL stands for what was lost
    released = next(change for change in run.trace if change.report_index == RING_SIZE)
    # By the report that stands for the loss, not by the watchdog: what was lost may have been the lift.
    assert run.trace[run.trace.index(released) - 1].report_index == RING_SIZE - 1
    assert (released.placement, run.states()[-2:]) == (None, [index_of(4), 0])
    assert driven_hz(happened.log)[-1] == 116.0
    assert is_silent(happened.log.events[-1])


def test_a_user_without_rights_is_told_how_to_get_them(guest: Guest) -> None:
    device = guest.result("kernel_device", KernelDevice)
    assert re.match(r"DigitizerError: no permission to read /dev/hidraw\d+ ", device.refused_digitizer)
    pattern = re.search(r'SUBSYSTEM=="hidraw", KERNELS=="(.+?)", TAG\+="uaccess"', device.refused_digitizer)
    assert pattern is not None, device.refused_digitizer
    assert fnmatchcase(device.kernel_name, pattern[1])
    assert re.match(r"LinkError: cannot open /dev/ttyACM\d+ .*Permission denied", device.refused_port)
    assert re.search(r"dialout|udev", device.refused_port)
