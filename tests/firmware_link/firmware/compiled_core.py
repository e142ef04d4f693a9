"""The C core for tests: built once in a folder of its own, and as a tier of the conformance suite."""

import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
from ctypes import CDLL
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_link.emulator import DeviceConfiguration
from firmware_link.emulator.c_core import CompiledFirmware, open_library
from tests.firmware_link.sensing_laws import ACCELEROMETER_OF_LAWS, sample_instants_us
from tests.tools.guard import allowed

FIRMWARE = Path(__file__).parents[3] / "firmware_link" / "firmware"
CHECKS = Path(__file__).parent / "c"
_EXTRA = [CHECKS / name for name in ("decoder.c", "held_samples.c", "adxl345_model.c")]
EXTRA = " ".join(map(str, (*_EXTRA, FIRMWARE / "boards" / "adxl345.c")))
LIBRARY = "libtactable_core.so"
FULL_OUTPUT = 32_767
US_PER_S = 1_000_000


def make(folder: Path, *arguments: str) -> str:
    """Run make in the firmware's folder; what it said. Fails the test with that where make fails."""
    with allowed("compiles the C core"):
        done = subprocess.run(
            ["make", "-C", str(FIRMWARE), f"BUILD={folder}", f"EXTRA={EXTRA}", *arguments],
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


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
    runtime = subprocess.run(["cc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    return os.environ | {
        "TACTABLE_CORE_LIBRARY": str(folder / LIBRARY),
        # Python is not built with the sanitizer, and does not free all that it has when it ends.
        "LD_PRELOAD": runtime.stdout.strip(),
        "ASAN_OPTIONS": "detect_leaks=0",
    }


class CompiledTier:
    """The C core without line or delay; its clock and the host's differ by a constant."""

    lease_ms = 40
    slack_us = 0

    def __init__(self) -> None:
        self._host_us = self._booted_us = 123_456_789
        self._boots = 0
        self._said = b""
        self._firmware = self._boot()
        self._samples: list[NDArray[np.int16]] = []

    def now_us(self) -> int:
        return self._host_us

    def write(self, data: bytes) -> None:
        self._said += self._firmware.receive(data, self._device_us())

    def wait(self, duration_us: int) -> None:
        end_us = self._host_us + duration_us
        if self._firmware.senses:
            for now_us in sample_instants_us(self._device_us(), self._device_us() + duration_us):
                self._said += self._firmware.advance(now_us)
                self._firmware.sense_now(now_us % 4_000)
        self._host_us = end_us
        self._said += self._firmware.advance(self._device_us())

    def read(self) -> bytes:
        said, self._said = self._said, b""
        return said

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        displacements = self.outputs(start_us, stop_us)[1]
        return tuple(np.abs(displacements).max(axis=0, initial=0.0))

    def outputs(self, start_us: int, stop_us: int) -> tuple[float, NDArray[np.float64]]:
        rate_hz = self._firmware.configuration.synthesis_rate_hz
        self._samples = [np.concatenate([*self._samples, self._firmware.take_samples()])]
        first, stop = (-(-time_us * rate_hz // US_PER_S) for time_us in (start_us, stop_us))
        assert stop <= len(self._samples[0])
        return rate_hz, self._samples[0][first:stop] / FULL_OUTPUT

    def reboot(self) -> None:
        self._firmware.close()
        self._firmware, self._booted_us, self._said, self._samples = self._boot(), self._host_us, b"", []

    def hang_up(self) -> None:
        self._said += self._firmware.hang_up(self._device_us())

    def _boot(self) -> CompiledFirmware:
        self._boots += 1
        configuration = DeviceConfiguration(boot_id=0x5EED + self._boots, **ACCELEROMETER_OF_LAWS)
        return CompiledFirmware(core_library(), configuration)

    def _device_us(self) -> int:
        return self._host_us - self._booted_us


class WatchedTier(CompiledTier):
    """The C core where what sounds must change only while samples are held back; see c/held_samples.c."""

    def write(self, data: bytes) -> None:
        self._said += self._firmware.advance(self._device_us())
        core_library().held_samples_look()
        super().write(data)
        self._check()

    def wait(self, duration_us: int) -> None:
        """Stops before each deadline, so that no sample runs between a look and what the device does by itself."""
        end_us = self._device_us() + duration_us
        while (deadline_us := self._firmware.next_deadline_us() or end_us) < end_us:
            super().wait(max(0, deadline_us - 1 - self._device_us()))
            core_library().held_samples_look()
            super().wait(max(1, deadline_us - self._device_us()))
            self._check()
        super().wait(end_us - self._device_us())
        self._check()

    def hang_up(self) -> None:
        self._said += self._firmware.advance(self._device_us())
        core_library().held_samples_look()
        super().hang_up()
        self._check()

    def _boot(self) -> CompiledFirmware:
        firmware = super()._boot()
        core_library().held_samples_watch(ctypes.c_void_p(firmware._host))
        return firmware

    @staticmethod
    def _check() -> None:
        assert core_library().held_samples_faults() == 0, "what sounds changed while samples were not held back"
