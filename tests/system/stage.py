"""One process an actor: the hardware, the firmware and the engine, and what they tell each other."""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import TypeVar

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.emulator_process import EmulatorLog
from tests.system.chain import PATIENCE_S
from tests.system.serial_gadget import serve_firmware

Value = TypeVar("Value")

_POLL_S = 0.02
_BOOT_ID = 0x5EED
_NOBODY = 65_534
# Forked, so that the guest reads the modules of the project from its slow disk only once.
_FORK = multiprocessing.get_context("fork")


class Cue:
    """Something that one process waits for and another brings about, once."""

    def __init__(self) -> None:
        self._event = _FORK.Event()

    def give(self) -> None:
        """It has happened."""
        self._event.set()

    def is_set(self) -> bool:
        """Whether it has happened: what the loop asks of a stop request."""
        return self._event.is_set()

    def wait(self) -> None:
        """Until it happens; raises TimeoutError when it does not."""
        if not self._event.wait(PATIENCE_S):
            raise TimeoutError("the other process did not do its part")


class Stage:
    """The cues of one scenario, and when what happened."""

    def __init__(self) -> None:
        self.plugged = Cue()
        self.opened = Cue()
        self.flooded = Cue()
        self.running = Cue()
        self.ended = Cue()
        self.running_again = Cue()
        self.ended_again = Cue()
        self.stop = Cue()
        self._taken = _FORK.Value("q", 0)
        self._notes, self._pen = _FORK.Pipe(duplex=False)

    def tell_taken(self, reports: int) -> None:
        """The engine has answered so many reports of its run."""
        self._taken.value = reports

    def taken(self) -> int:
        """Reports of its run that the engine has answered."""
        return int(self._taken.value)

    def wait_until_taken(self, reports: int) -> None:
        """Until the engine has answered so many reports; raises TimeoutError when it does not."""
        end_s = time.monotonic() + PATIENCE_S
        while self.taken() < reports:
            if time.monotonic() > end_s:
                raise TimeoutError(f"the engine took {self.taken()} of {reports} reports")
            time.sleep(_POLL_S)

    def note(self, name: str) -> None:
        """Write down that this happens now."""
        self._pen.send((name, time.monotonic_ns()))

    def notes(self) -> dict[str, int]:
        """Monotonic time of each note, in ns."""
        notes = dict[str, int]()
        while self._notes.poll():
            name, time_ns = self._notes.recv()
            notes[name] = time_ns
        return notes


@contextmanager
def hardware(script: Callable[[Stage], None]) -> Iterator[Stage]:
    """The hardware does its script in a process of its own; when that ends, however it ends, the engine stops."""
    stage = Stage()

    def act() -> None:
        try:
            script(stage)
        finally:
            stage.stop.give()

    process = _FORK.Process(target=act)
    process.start()
    try:
        yield stage
        process.join(PATIENCE_S)
    finally:
        process.kill()
        process.join()


@contextmanager
def emulated_firmware() -> Iterator[Callable[[], EmulatorLog]]:
    """The firmware at the gadget's end, booted anew; call what is yielded once: it ends it and returns its log."""
    ours, theirs = _FORK.Pipe()
    process = _FORK.Process(target=serve_firmware, args=(DeviceConfiguration(_BOOT_ID), theirs))
    process.start()

    def end() -> EmulatorLog:
        ours.send("end")
        if not ours.poll(PATIENCE_S):
            raise TimeoutError("the firmware left no log")
        log: EmulatorLog = ours.recv()
        return log

    try:
        yield end
    finally:
        process.kill()
        process.join()


def error_as_nobody(action: Callable[[], object]) -> str:
    """Type and words of the error that `action` raises for a user without any right; "" when it raises none."""
    ours, theirs = _FORK.Pipe(duplex=False)
    process = _FORK.Process(target=_act_as_nobody, args=(action, theirs))
    process.start()
    process.join(PATIENCE_S)
    process.kill()
    if not ours.poll():
        raise TimeoutError("the process without rights said nothing")
    error: str = ours.recv()
    return error


def _act_as_nobody(action: Callable[[], object], pen: Connection) -> None:
    os.setgroups([])
    os.setgid(_NOBODY)
    os.setuid(_NOBODY)
    error = ""
    try:
        action()
    except Exception as raised:
        error = f"{type(raised).__name__}: {raised}"
    pen.send(error)


def until_it_works(action: Callable[[], Value]) -> Value:
    """What `action` returns once it raises nothing: a device that was plugged in takes a moment to appear."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return action()
        except Exception:
            if time.monotonic() > end_s:
                raise
        time.sleep(_POLL_S)
