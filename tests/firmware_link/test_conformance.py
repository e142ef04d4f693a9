"""The laws of every device, kept by the emulated firmware in virtual time."""

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_link.emulator import DeviceConfiguration, EmulatedFirmware, synthesise
from tests.firmware_link.conformance import HANG_UP_LAWS, LAWS, WAVE_LAWS, HangUpLaw, Law, WaveLaw
from tests.firmware_link.sensing_laws import ACCELEROMETER_OF_LAWS, SENSING_LAWS, sample_instants_us

SAMPLE_RATE_HZ = 20_000.0


class VirtualTier:
    """An emulated firmware without line or delay; its clock and the host's differ by a constant."""

    lease_ms = 40
    slack_us = 0

    def __init__(self) -> None:
        self._host_us = self._booted_us = 123_456_789
        self._boots = 0
        self._said = b""
        self._firmware = self._boot()

    def now_us(self) -> int:
        return self._host_us

    def write(self, data: bytes) -> None:
        self._said += self._firmware.receive(data, self._device_us())

    def wait(self, duration_us: int) -> None:
        end_us = self._host_us + duration_us
        if self._firmware.senses:
            for now_us in sample_instants_us(self._device_us(), self._device_us() + duration_us):
                self._said += self._firmware.advance(now_us)
                self._firmware.sense(now_us % 4_000, [0, 0], now_us * 48 // 1_000)
        self._host_us = end_us
        self._said += self._firmware.advance(self._device_us())

    def read(self) -> bytes:
        said, self._said = self._said, b""
        return said

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        displacements = self.outputs(start_us, stop_us)[1]
        return tuple(np.abs(displacements).max(axis=0, initial=0.0)) or (0.0,)

    def outputs(self, start_us: int, stop_us: int) -> tuple[float, NDArray[np.float64]]:
        return SAMPLE_RATE_HZ, synthesise(self._firmware.drive_log, start_us, stop_us, SAMPLE_RATE_HZ)

    def reboot(self) -> None:
        self._firmware, self._booted_us, self._said = self._boot(), self._host_us, b""

    def hang_up(self) -> None:
        self._said += self._firmware.hang_up(self._device_us())

    def _boot(self) -> EmulatedFirmware:
        self._boots += 1
        return EmulatedFirmware(DeviceConfiguration(boot_id=0x5EED + self._boots, **ACCELEROMETER_OF_LAWS))

    def _device_us(self) -> int:
        return self._host_us - self._booted_us


@pytest.mark.parametrize("law", [*LAWS, *WAVE_LAWS, *HANG_UP_LAWS, *SENSING_LAWS], ids=lambda law: law.__name__)
def test_the_emulated_firmware_keeps(law: Law | WaveLaw | HangUpLaw) -> None:
    law(VirtualTier())
