"""Touch screen to firmware through the drivers of a real kernel, in a guest; guest.py says what happens there."""

import pickle
import re
import shlex
import subprocess
import sys
import time
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeVar

import pytest

from engine.loop import CommandRecord
from engine.touch import state_index
from engine.touch.digitizer import RELEASE_AFTER_NS
from engine.touch.sources.playback import Playback
from firmware_link.emulator import Cause, DriveEvent, Outcome
from firmware_link.emulator.process import EmulatorLog, run_emulator
from firmware_link.host.serial_port import SerialPort
from tests.engine.made_states import states_of
from tests.engine.render.made_steady import MadeSteady
from tests.system.chain import BIT_RATE_HZ, DEVICE, ChainRun, driven_hz, is_silent, run_chain
from tests.system.guest import DEMO, HELD, SWEPT, TAP
from tests.system.results import Broken, Happened, KernelDevice, Refusals

Result = TypeVar("Result")

pytestmark = pytest.mark.machine

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
# Only against a guest that hangs: it is done within 2 minutes, on a crowded machine within 4.
GUEST_LIMIT_S = 600
# hidraw keeps this many reports and drops the newest.
RING = 63
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


@pytest.fixture(scope="module")
def beside() -> tuple[ChainRun, EmulatorLog]:
    """The same recording without a kernel's drivers: played into the engine, to an emulator behind a pty."""
    with run_emulator(number_of_actuators=2) as emulator:
        run = run_chain(Playback(DEMO), SerialPort(emulator.port, BIT_RATE_HZ), None, lambda: None)
        return run, emulator.stop()


@pytest.fixture(scope="module")
def whole_chain(guest: Guest) -> Happened:
    return guest.result("whole_chain", Happened)


def index_of(zone: int) -> int:
    return state_index(states_of(DEVICE, [zone]))


def time_ns(happened: Happened, event: DriveEvent) -> int:
    return happened.log.host_ns_at_device_zero + 1000 * event.device_time_us


def last_before(happened: Happened, note: str) -> DriveEvent:
    return [event for event in happened.log.events if time_ns(happened, event) < happened.notes[note]][-1]


def played_for(happened: Happened, change: CommandRecord) -> DriveEvent | None:
    """The firmware's change of drive by the command of a state; None where it was never sent, stale or no change."""
    since_ns = [(event, time_ns(happened, event) - change.time_ns) for event in happened.log.events]
    near = (event for event, passed_ns in since_ns if 0 <= passed_ns < SAME_SEQUENCE_NS and event.cause is Cause.SET)
    return next((event for event in near if event.sequence == change.drive_sequence), None)


def test_the_kernel_takes_the_virtual_device_for_a_touch_screen(guest: Guest) -> None:
    device = guest.result("kernel_device", KernelDevice)
    assert (device.driver, device.product_name) == ("hid-multitouch", DEMO.name)
    assert device.descriptor == DEMO.descriptor


def test_the_guest_renders_the_states_of_the_run_beside_it(
    whole_chain: Happened, beside: tuple[ChainRun, EmulatorLog]
) -> None:
    (run,) = whole_chain.runs
    assert run.link_error is None
    assert run.states() == beside[0].states()
    assert len(run.states()) == 17


def test_the_firmware_plays_what_it_plays_beside(whole_chain: Happened, beside: tuple[ChainRun, EmulatorLog]) -> None:
    assert driven_hz(whole_chain.log) == driven_hz(beside[1])


def test_every_report_reaches_the_engine_and_completes_a_frame(whole_chain: Happened) -> None:
    (run,) = whole_chain.runs
    assert run.counters.reports == run.counters.frames == len(DEMO.reports)
    assert (whole_chain.source.overflows, whole_chain.source.losses) == (0, 0)


def test_every_drive_sent_reaches_the_firmware_which_takes_it_or_finds_it_stale(whole_chain: Happened) -> None:
    (run,) = whole_chain.runs
    outcomes = [frame.outcome for frame in whole_chain.log.received if frame.message == "SET"]
    assert len(outcomes) == run.link_counters.sent + run.link_counters.renewed
    assert set(outcomes) <= {Outcome.ACCEPTED, Outcome.STALE, Outcome.REFUSED}
    assert outcomes.count(Outcome.ACCEPTED) == whole_chain.log.counters["applied"] > len(outcomes) / 2
    assert [whole_chain.log.counters[name] for name in ("crc", "framing", "length", "overrun")] == [0] * 4


def test_every_command_that_is_played_is_that_of_its_state(whole_chain: Happened) -> None:
    (run,) = whole_chain.runs
    made = MadeSteady(DEVICE)
    frequencies_hz = [
        (channel.frequency_hz, made.frequency_hz(change.placement))
        for change in run.trace
        if change.placement is not None and (event := played_for(whole_chain, change)) is not None
        for channel in event.channels
    ]
    assert len(frequencies_hz) >= 12
    assert all(is_hz == expected_hz for is_hz, expected_hz in frequencies_hz)


def test_a_stopped_run_leaves_the_firmware_silent_and_latched(whole_chain: Happened) -> None:
    assert is_silent(whole_chain.log.events[-1])
    last = whole_chain.log.received[-1]
    assert (last.message, last.outcome) == ("STOP", Outcome.ACCEPTED)
    assert whole_chain.runs[0].link_counters.acknowledged >= 2


def test_an_unplugged_touch_screen_is_silent_and_goes_on_when_it_is_back(guest: Guest) -> None:
    happened = guest.result("touch_screen_unplugged", Happened)
    (run,) = happened.runs
    assert run.link_error is None
    assert (happened.source.losses, happened.source.reconnects) == (1, 1)
    assert run.counters.reports == len(HELD.reports) + len(TAP.reports)
    assert run.states() == [index_of(0), index_of(4), 0]
    assert is_silent(last_before(happened, "plugged in again"))
    assert driven_hz(happened.log) == [101.0, 116.0]


def test_an_unplugged_port_is_a_link_error_that_says_what_to_do(guest: Guest) -> None:
    first, second = guest.result("gadget_unplugged", Happened).runs
    assert re.fullmatch(r"/dev/ttyACM\d+ is gone \(.+\): plug the device in and connect again", first.link_error or "")
    assert second.link_error is None


def test_the_firmware_of_an_unplugged_port_falls_silent_by_itself(guest: Guest) -> None:
    happened = guest.result("gadget_unplugged", Happened)
    last = last_before(happened, "plugged in again")
    assert is_silent(last)
    # But for a guest that stalled at the last moment, so that the engine took the finger for gone.
    assert last.cause is Cause.LEASE_EXPIRED or happened.runs[0].trace[-1].placement is None


def test_a_port_that_is_back_is_found_by_its_stable_id_and_driven_anew(guest: Guest) -> None:
    happened = guest.result("gadget_unplugged", Happened)
    first, second = happened.runs
    assert first.states() == [index_of(0)]
    assert second.states()[-2:] == [index_of(4), 0]
    assert driven_hz(happened.log) == [101.0, 116.0]
    assert is_silent(happened.log.events[-1])


def test_an_overflow_is_counted_released_and_forgotten(guest: Guest) -> None:
    happened = guest.result("overflow", Happened)
    (run,) = happened.runs
    assert len(SWEPT.reports) > RING
    assert happened.source.overflows == 1
    assert run.counters.reports == RING + len(TAP.reports)
    released = next(change for change in run.trace if change.report_index is None)
    before = run.trace[run.trace.index(released) - 1]
    assert before.report_index is not None
    assert before.report_index < RING
    # At once, not by the watchdog: what was lost may have been the lift.
    assert released.time_ns - before.time_ns < RELEASE_AFTER_NS
    assert (released.placement, run.states()[-2:]) == (None, [index_of(4), 0])
    assert driven_hz(happened.log)[-1] == 116.0
    assert is_silent(happened.log.events[-1])


def test_a_user_without_rights_is_told_the_udev_rule_that_fits_the_device(guest: Guest) -> None:
    error = guest.result("refusals", Refusals).digitizer
    assert re.match(r"DigitizerError: no permission to read /dev/hidraw\d+ ", error)
    pattern = re.search(r'SUBSYSTEM=="hidraw", KERNELS=="(.+?)", TAG\+="uaccess"', error)
    assert pattern is not None, error
    assert fnmatchcase(guest.result("kernel_device", KernelDevice).kernel_name, pattern[1])


def test_a_user_without_rights_is_told_which_port_refused(guest: Guest) -> None:
    error = guest.result("refusals", Refusals).port
    assert re.match(r"LinkError: cannot open /dev/ttyACM\d+ .*Permission denied", error)


def test_a_user_without_rights_is_told_how_to_get_the_port(guest: Guest) -> None:
    assert re.search(r"dialout|udev", guest.result("refusals", Refusals).port)
