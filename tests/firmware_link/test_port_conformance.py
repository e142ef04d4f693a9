"""Some laws of every device, kept by the emulator's process behind a real pseudo-terminal, in real time."""

import contextlib
import time
from collections.abc import Callable
from typing import Self

import numpy as np
import pytest

from base.arrays import Array
from firmware_link.emulator.emulator_process import RunningEmulator, run_emulator
from firmware_link.emulator.synthesis import synthesise
from firmware_link.host.serial_port import SerialPort
from tests.firmware_link import click_laws, drive_laws
from tests.firmware_link.test_conformance import keep_each_law

SAMPLE_RATE_HZ = 20_000.0
NS_PER_US = 1_000
US_PER_S = 1e6


class PortTier:
    """An emulator that has just booted, and its port; what the actuators did is in its log."""

    lease_ms = 100
    slack_us = 20_000

    def __init__(self, emulator: RunningEmulator) -> None:
        self._emulator = emulator
        self._port: SerialPort | None = None

    def rebooted(self) -> Self:
        self.hang_up()
        self.reboot()
        return self

    def now_us(self) -> int:
        return time.monotonic_ns() // NS_PER_US

    def write(self, data: bytes) -> None:
        if self._port is None:
            self._port = SerialPort(self._emulator.port)
        while data:
            data = data[self._port.write(data) :]

    def wait(self, duration_us: int) -> None:
        time.sleep(duration_us / US_PER_S)

    def read(self) -> bytes:
        return b"" if self._port is None else self._port.read()

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        displacements = self.outputs(start_us, stop_us)[1]
        return tuple(np.abs(displacements).max(axis=0, initial=0.0)) or (0.0,)

    def outputs(self, start_us: int, stop_us: int) -> tuple[float, Array]:
        log = self._emulator.log()
        return SAMPLE_RATE_HZ, synthesise(log.events, start_us, stop_us, SAMPLE_RATE_HZ)

    def reboot(self) -> None:
        self._emulator.reboot()
        self.read()

    def hang_up(self) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None

    close = hang_up


# The real line takes part in these: a hang-up, what comes in pieces, much in a row, and leases that run meanwhile.
REAL: tuple[Callable[[PortTier], None], ...] = (
    click_laws.wave_law_a_dropped_line_latches_at_once,
    drive_laws.law_a_drive_ends_with_its_lease,
    drive_laws.law_any_garbage_ends_at_the_next_delimiter,
    click_laws.law_an_armed_device_plays_its_basis_until_the_next_is_whole,
    drive_laws.law_a_rebooted_device_is_not_driven_by_old_traffic,
    click_laws.wave_law_takeovers_make_no_step,
)


@pytest.mark.machine
def test_the_emulator_behind_its_port_keeps_the_laws() -> None:
    with run_emulator() as emulator, contextlib.closing(PortTier(emulator)) as tier:
        keep_each_law(REAL, tier.rebooted)
