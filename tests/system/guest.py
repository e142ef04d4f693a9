"""Scenarios with devices of the guest's own kernel, to a pickle of what happened; as root, in the guest only.

python -c "from tests.system.guest import main; main()" FILE
"""

import contextlib
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from engine.touch.sources.hid_discovery import load_hid_system
from engine.touch.sources.hidraw import RING_SIZE, HidrawCounters, HidrawSource, open_hidraw
from engine.touch.sources.recording import Recording
from firmware_link.emulator.emulator_process import EmulatorLog
from firmware_link.host.serial_port import SerialPort, path_of
from tests.system.chain import BIT_RATE_HZ, PATIENCE_S, ChainRun, run_chain
from tests.system.serial_gadget import SERIAL_NUMBER, build_gadget, plug_gadget, unplug_gadget
from tests.system.stage import Stage, emulated_firmware, error_as_nobody, hardware, until_it_works
from tests.system.uhid import VirtualDevice, kernel_path_of
from tests.tactable.rig.strokes import DEMO_STROKES, Stroke, make_recording
from tests.tools.stalls import watched

TOUCH_SERIAL_NUMBER = "TACTABLE-SYSTEM-TOUCH"
CONTACT_COUNT_MAXIMUM = {2: bytes((2, 10))}
FLOOD = 100
"""Reports sent while nobody reads: more than hidraw keeps."""

DEMO = make_recording([replace(each, start_s=each.start_s / 2, stop_s=each.stop_s / 2) for each in DEMO_STROKES])
"""The strokes of the demo, each of half its time."""
_LIFTED = make_recording([Stroke(0.0, 0.4, 0.1, 0.1)])
HELD = replace(_LIFTED, reports=_LIFTED.reports[:-1])
"""A finger in zone I that does not lift."""
TAP = make_recording([Stroke(0.0, 0.5, 0.9, 0.9)])
"""A finger in zone V, up at the end."""
SWEPT = make_recording([Stroke(0.0, 0.008 * FLOOD, 0.05, 0.95)])
"""A finger from end to end; its later reports and the lift are lost."""

# The guest is slow: half the pace, a report each 16 ms, is still that of a live digitizer.
SPEED = 0.5
MOST_UNREAD = 20
"""Reports that the engine may be behind: a guest of any slowness then loses none."""
ATTEMPTS, STALL_S = 2, 0.1
UNPLUGGED_S = 1.0


@dataclass(frozen=True)
class Happened:
    """One scenario: each run of the engine, the last source's counts, the firmware's log, what the hardware did when.

    Times are monotonic ns.
    """

    runs: tuple[ChainRun, ...]
    source: HidrawCounters
    log: EmulatorLog
    notes: dict[str, int]


@dataclass(frozen=True)
class KernelDevice:
    """The digitizer as the kernel shows it, and what a user without rights is told who opens it or the port."""

    kernel_name: str
    driver: str
    product_name: str
    descriptor: bytes
    refused_digitizer: str
    refused_port: str


@dataclass(frozen=True)
class Broken:
    """A scenario that did not come to its end."""

    trace: str


def kernel_device() -> KernelDevice:
    """Plug the touch screen in, look at it, and open it and the port without the right to."""

    def script(stage: Stage) -> None:
        with touch_screen():
            stage.plugged.give()
            stage.ended.wait()

    with hardware(script) as stage:
        stage.plugged.wait()
        with open_touch_screen() as source:
            path = kernel_path_of(DEMO.vendor_id, DEMO.product_id)
        port, system = until_it_works(lambda: path_of(SERIAL_NUMBER)), load_hid_system()
        found = KernelDevice(
            kernel_name=path.name,
            driver=path.joinpath("driver").resolve().name,
            product_name=source.name,
            descriptor=source.descriptor,
            refused_digitizer=error_as_nobody(lambda: open_hidraw(system, TOUCH_SERIAL_NUMBER)),
            refused_port=error_as_nobody(lambda: SerialPort(port)),
        )
        stage.ended.give()
        return found


def whole_chain() -> Happened:
    """Play the demo's strokes on the touch screen."""

    def script(stage: Stage) -> None:
        with touch_screen() as screen:
            stage.plugged.give()
            stage.running.wait()
            play(stage, screen, DEMO)
            stage.stop.give()
            stage.ended.wait()

    return play_script(script)


def touch_screen_unplugged() -> Happened:
    """Unplug the touch screen under a finger, plug it in again, tap."""

    def script(stage: Stage) -> None:
        with touch_screen() as screen:
            stage.plugged.give()
            stage.running.wait()
            play(stage, screen, HELD)
        stage.wait_until_taken(len(HELD.reports) + 1)
        with touch_screen() as screen:
            assert screen.opened.wait(PATIENCE_S), "the engine did not open it again"
            play(stage, screen, TAP)
            stage.stop.give()
            stage.ended.wait()

    return play_script(script)


def gadget_unplugged() -> Happened:
    """Unplug the serial gadget under a finger, plug it in again, run anew, tap."""

    def script(stage: Stage) -> None:
        with touch_screen() as screen:
            stage.plugged.give()
            stage.running.wait()
            play(stage, screen, HELD)
            unplug_gadget()
            stage.ended.wait()
            time.sleep(UNPLUGGED_S)
            stage.note("plugged in again")
            plug_gadget()
            stage.running_again.wait()
            play(stage, screen, TAP)
            stage.stop.give()
            stage.ended_again.wait()

    with emulated_firmware() as end_firmware, hardware(script) as stage:
        stage.plugged.wait()
        with open_touch_screen() as source:
            first = run_chain(source, open_port(), stage.stop, stage.running.give, stage.tell_taken)
            stage.ended.give()
            second = run_chain(source, open_port(), stage.stop, stage.running_again.give, stage.tell_taken)
        stage.ended_again.give()
        return Happened((first, second), source.counters, end_firmware(), stage.notes())


def overflow() -> Happened:
    """Send more reports than hidraw keeps before the engine reads one; tap once they are answered."""

    def script(stage: Stage) -> None:
        with touch_screen() as screen:
            stage.plugged.give()
            stage.opened.wait()
            for report in SWEPT.reports:
                screen.send(report.data)
            stage.flooded.give()
            stage.running.wait()
            # A slow guest that still reads takes what comes meanwhile for part of the flood.
            stage.wait_until_taken(RING_SIZE + 1)
            play(stage, screen, TAP)
            stage.stop.give()
            stage.ended.wait()

    def flooded(stage: Stage) -> None:
        stage.opened.give()
        stage.flooded.wait()

    return play_script(script, flooded)


SCENARIOS: tuple[Callable[[], object], ...] = (
    kernel_device,
    whole_chain,
    overflow,
    touch_screen_unplugged,
    gadget_unplugged,
)


def play_script(script: Callable[[Stage], None], on_opened: Callable[[Stage], None] = lambda _: None) -> Happened:
    """One run of the engine beside the hardware's script, from when it is plugged in until it stops."""
    with emulated_firmware() as end_firmware, hardware(script) as stage:
        stage.plugged.wait()
        with open_touch_screen() as source:
            on_opened(stage)
            run = run_chain(source, open_port(), stage.stop, stage.running.give, stage.tell_taken)
        stage.ended.give()
        return Happened((run,), source.counters, end_firmware(), stage.notes())


def play(stage: Stage, screen: VirtualDevice, recording: Recording) -> None:
    """Send the reports at their pace, or as slowly as the engine answers them, until it has answered all."""
    before, last_s = stage.taken(), 0.0
    for number, report in enumerate(recording.reports, before):
        time.sleep((report.time_s - last_s) / SPEED)
        stage.wait_until_taken(number - MOST_UNREAD)
        screen.send(report.data)
        last_s = report.time_s
    stage.wait_until_taken(before + len(recording.reports))


def touch_screen() -> VirtualDevice:
    return VirtualDevice(DEMO, TOUCH_SERIAL_NUMBER, CONTACT_COUNT_MAXIMUM)


@contextlib.contextmanager
def open_touch_screen() -> Iterator[HidrawSource]:
    """By the name that stays, as soon as the kernel shows it."""
    system = load_hid_system()
    with contextlib.closing(until_it_works(lambda: open_hidraw(system, TOUCH_SERIAL_NUMBER))) as source:
        yield source


def open_port() -> SerialPort:
    """By the name that stays, as soon as the kernel shows it."""
    return until_it_works(lambda: SerialPort(SERIAL_NUMBER, BIT_RATE_HZ))


def run_undisturbed(scenario: Callable[[], object]) -> object:
    """The scenario; once more where the machine stalled so long that the engine lifted fingers, as it then should."""
    for _ in range(ATTEMPTS):
        with watched(STALL_S) as stalls:
            result = scenario()
        if not stalls:
            break
        say(f"{scenario.__name__}: {stalls}")
    return result


def say(line: str) -> None:
    """For the console of the guest, which the tests show when one fails."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Every scenario; a broken one does not keep the others from running."""
    target = Path(sys.argv[1])
    build_gadget()
    plug_gadget()
    results = dict[str, object]()
    for scenario in SCENARIOS:
        start_s = time.monotonic()
        try:
            results[scenario.__name__] = run_undisturbed(scenario)
        except Exception:
            results[scenario.__name__] = Broken(traceback.format_exc())
        say(f"{scenario.__name__}: {time.monotonic() - start_s:.1f} s")
    target.write_bytes(pickle.dumps(results))
