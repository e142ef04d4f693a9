"""The conformance suite: one law a function of `drive_laws` and `click_laws`, over any device that a `Tier` reaches.

Times of a law are the device's own, from its STATUS, so that a slow machine or line makes no law fail. Laws of real
time are given slack by the tier. Here they are kept by the emulated firmware behind its process's own server, in
virtual time.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import numpy as np
import pytest

from base.arrays import Array
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.emulator_process import decode_log
from firmware_link.emulator.synthesis import synthesise
from firmware_link.protocol.messages import MAXIMUM_ACTUATORS
from tests.firmware_link import click_laws, drive_laws
from tests.firmware_link.law_host import Law, Tier, WaveLaw
from tests.firmware_link.sensing_laws import ACCELEROMETER_OF_LAWS, SAMPLE_RATE_HZ, SENSING_LAWS
from tests.tools.virtual import VirtualClock, VirtualLine

T = TypeVar("T", bound=Tier)


def keep_each_law(laws: Iterable[Callable[[T], None]], boot: Callable[[], T]) -> None:
    """Each law over a device that has just booted; a failure names its law."""
    for law in laws:
        try:
            law(boot())
        except AssertionError as error:
            error.add_note(f"law: {law.__name__}")
            raise


def _laws(prefix: str) -> Iterator[Callable[..., None]]:
    return (value for name, value in (vars(drive_laws) | vars(click_laws)).items() if name.startswith(prefix))


LAWS: tuple[Law, ...] = tuple(_laws("law_"))
WAVE_LAWS: tuple[WaveLaw, ...] = tuple(_laws("wave_law_"))


SYNTHESIS_RATE_HZ = 20_000.0
SAMPLE_PERIOD_NS = 1_000_000_000 // SAMPLE_RATE_HZ


class VirtualTier:
    """A line without delay to a device with an accelerometer; both clocks differ by a constant."""

    lease_ms = 40
    slack_us = 0

    kind: type[VirtualLine] = VirtualLine

    def __init__(self, actuators: int = 2) -> None:
        clock = VirtualClock(123_456_789_000)
        sensor = {} if actuators == MAXIMUM_ACTUATORS else ACCELEROMETER_OF_LAWS  # which has no room for so many
        configuration = DeviceConfiguration(0, number_of_actuators=actuators, **sensor)
        self.line = self.kind(configuration, delay_ns=0, booted_ns=clock.time_ns, clock=clock)
        clock.actors.append(self)

    def now_us(self) -> int:
        return self.line.time_ns // 1_000

    def write(self, data: bytes) -> None:
        if not self.line.is_open:
            self.line.open()
        self.line.write(data)

    def wait(self, duration_us: int) -> None:
        self.line.clock.run_to(self.line.time_ns + 1_000 * duration_us)

    def read(self) -> bytes:
        return self.line.read() if self.line.is_open else b""

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        displacements = self.outputs(start_us, stop_us)[1]
        return tuple(np.abs(displacements).max(axis=0, initial=0.0)) or (0.0,)

    def outputs(self, start_us: int, stop_us: int) -> tuple[float, Array]:
        log = decode_log(json.loads(json.dumps(self.line.server.log())))
        return SYNTHESIS_RATE_HZ, synthesise(log.events, start_us, stop_us, SYNTHESIS_RATE_HZ)

    def reboot(self) -> None:
        self.line.server.reboot(self.line.time_ns)
        self.read()

    def hang_up(self) -> None:
        self.line.close()

    # ---- the accelerometer's samples, while they are wanted ----

    def next_ns(self) -> int | None:
        now_ns = self.line.time_ns
        return now_ns + SAMPLE_PERIOD_NS - now_ns % SAMPLE_PERIOD_NS if self.line.firmware.senses else None

    def act(self, now_ns: int) -> None:
        if now_ns % SAMPLE_PERIOD_NS == 0 and self.line.firmware.senses:
            self.sense(self.line.device_us())

    def sense(self, now_us: int) -> None:
        displacements = [0] * self.line.configuration.number_of_actuators
        self.line.firmware.sense(now_us % 4_000, displacements, now_us * 48 // 1_000)


@pytest.mark.parametrize("law", [*LAWS, *WAVE_LAWS, *SENSING_LAWS], ids=lambda law: law.__name__)
def test_the_emulated_firmware_keeps(law: Law | WaveLaw) -> None:
    law(VirtualTier())


@pytest.mark.long
def test_an_emulated_board_of_more_actuators_keeps_all_laws() -> None:
    for law in (*LAWS, *WAVE_LAWS, *SENSING_LAWS):
        law(VirtualTier(actuators=8))
