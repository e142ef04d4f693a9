"""The C core for tests: built once in a folder of its own, and as a tier of the conformance suite."""

import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
from ctypes import CDLL
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from base.arrays import Array
from firmware_link.emulator.c_core import CompiledFirmware, open_library
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.protocol.basis import Basis, transfer_messages
from firmware_link.protocol.framing import FrameEncoder
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import Arm
from tests.firmware_link.law_host import greeting
from tests.firmware_link.test_conformance import VirtualTier
from tests.firmware_link.virtual_rig import BOOT_ID
from tests.tools.guard import allowed
from tests.tools.virtual import VirtualLine

FIRMWARE = Path(__file__).parents[3] / "firmware_link" / "firmware"
CHECKS = Path(__file__).parent / "c"
_EXTRA = [CHECKS / name for name in ("decoder.c", "held_samples.c", "adxl345_model.c")]
EXTRA = " ".join(map(str, (*_EXTRA, FIRMWARE / "boards" / "adxl345.c")))
LIBRARY = "libtactable_core.so"
FULL_OUTPUT = 32_767
US_PER_S = 1_000_000


def make(folder: Path, *arguments: str) -> None:
    """Run make in the firmware's folder; fails the test with what it said where make fails."""
    with allowed("compiles the C core"):
        done = subprocess.run(
            ["make", "-C", str(FIRMWARE), f"BUILD={folder}", f"EXTRA={EXTRA}", *arguments],
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr


def need(*commands: str) -> None:
    """Skip, by name, where one of the commands is not installed."""
    missing = [command for command in commands if shutil.which(command) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed")


@functools.cache
def core_library() -> CDLL:
    """The library that TACTABLE_CORE_LIBRARY names, or one built now."""
    path = os.environ.get("TACTABLE_CORE_LIBRARY")
    if path is not None:
        return open_library(Path(path))
    need("make", "cc")
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder), "host")
        return open_library(Path(folder) / LIBRARY)


def with_sanitizers(folder: Path) -> dict[str, str]:
    """The environment for a process that loads the library in this folder, built with AddressSanitizer."""
    return under_sanitizers() | {"TACTABLE_CORE_LIBRARY": str(folder / LIBRARY)}


def under_sanitizers() -> dict[str, str]:
    """The environment for a process of Python that loads what was built with AddressSanitizer."""
    runtime = subprocess.run(["cc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    # Python is not built with the sanitizer, and does not free all that it has when it ends.
    return os.environ | {"LD_PRELOAD": runtime.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0"}


def sense_now(firmware: CompiledFirmware, acceleration: int) -> None:
    """Give it a sample of the accelerometer in counts, as a board's interrupt does."""
    core_library().host_sense(ctypes.c_void_p(firmware._host), acceleration)


class CompiledLine(VirtualLine):
    """To the C core, where what sounds must change only while samples are held back; see c/held_samples.c."""

    def start(self, boot_id: int) -> CompiledFirmware:
        firmware = CompiledFirmware(core_library(), replace(self.configuration, boot_id=boot_id))
        core_library().held_samples_watch(ctypes.c_void_p(firmware._host))
        return firmware


class CompiledTier(VirtualTier):
    """The C core in the place of the emulated firmware; its samples are kept, and it is watched."""

    kind = CompiledLine

    def __init__(self, actuators: int = 2) -> None:
        super().__init__(actuators)
        self._samples: list[NDArray[np.int16]] = []

    def outputs(self, start_us: int, stop_us: int) -> tuple[float, Array]:
        firmware = self.line.firmware
        rate_hz = firmware.configuration.synthesis_rate_hz
        self._samples = [np.concatenate([*self._samples, firmware.take_samples()])]
        first, stop = (-(-time_us * rate_hz // US_PER_S) for time_us in (start_us, stop_us))
        assert stop <= len(self._samples[0])
        return rate_hz, self._samples[0][first:stop] / FULL_OUTPUT

    def reboot(self) -> None:
        super().reboot()
        self._samples = []

    def sense(self, now_us: int) -> None:
        sense_now(self.line.firmware, now_us % 4_000)

    def write(self, data: bytes) -> None:
        self._look()
        super().write(data)
        self._check()

    def wait(self, duration_us: int) -> None:
        """Stops before each deadline, so that no sample runs between a look and what the device does by itself."""
        line = self.line
        end_us = line.device_us() + duration_us
        while (deadline_us := line.firmware.next_deadline_us() or end_us) < end_us:
            super().wait(max(0, deadline_us - 1 - line.device_us()))
            core_library().held_samples_look()
            super().wait(max(1, deadline_us - line.device_us()))
            self._check()
        super().wait(end_us - line.device_us())
        self._check()

    def hang_up(self) -> None:
        self._look()
        super().hang_up()
        self._check()

    def _look(self) -> None:
        self.line.server.step(self.line.time_ns)
        core_library().held_samples_look()

    @staticmethod
    def _check() -> None:
        assert core_library().held_samples_faults() == 0, "what sounds changed while samples were not held back"


class Played:
    """A C core that is armed, and what its actuators get from then on."""

    def __init__(
        self, rate_hz: int, limits: tuple[int, ...], slew_per_s: int, basis: Basis | None = None, lease_ms: int = 40
    ) -> None:
        self.now_us, self.encoder = 1_000, FrameEncoder()
        self._firmware = CompiledFirmware(core_library(), DeviceConfiguration(BOOT_ID, synthesis_rate_hz=rate_hz))
        transfer = transfer_messages(basis.data) if basis else []
        for message in (greeting(), *transfer, Arm(BOOT_ID, slew_per_s, lease_ms, 0, limits)):
            self.send(message)
        self._firmware.take_samples()

    def send(self, message: Message) -> None:
        self._firmware.receive(self.encoder.encode(message), self.now_us)

    def wait(self, duration_us: int) -> None:
        self.now_us += duration_us
        self._firmware.run_until(self.now_us)

    def take(self) -> NDArray[np.int16]:
        """Samples (time, actuator) since it was armed; ends the device."""
        samples = self._firmware.take_samples()
        self._firmware.close()
        return samples
