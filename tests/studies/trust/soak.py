"""A session in virtual time, with faults: nothing stale is applied, and every counter reconciles.

It gives 1000 commands a second, a tenth of them clicks of a basis.
"""

import math
import struct
from collections import Counter
from dataclasses import asdict, dataclass, field

import numpy as np

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause, ChannelTarget, PlayedWaveform
from firmware_link.emulator.fault_plan import parse_fault_plan
from firmware_link.emulator.faulty_device import FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import FULL_SCALE_WORD, WORDS_PER_TURN, DeviceState
from tests.firmware_link.law_host import Clicks

COMMANDS_PER_S = 1_000
BIT_RATE_HZ = 2_000_000
LEASE_MS = 40
US_PER_S = 1_000_000
NS_PER_US = 1_000
RECONNECT_US = 100_000
# The oldest that an applied command may be: one lease by the device's clock, and what the host errs about that clock.
AGE_BOUND_US = LEASE_MS * 1_000 + 2_000
# What the device's clock errs over the longest waveform.
CLOCK_SLACK_US = 50
HOST_START_US = 77_000_000_000
# Commands are numbered by their words of frequency and phase.
LOWEST_FREQUENCY, FREQUENCIES = 100, 1 << 15
RESOLUTION_HZ = 0.01
# Every tenth command is a click; after every 400th of them nothing comes, and it plays to its end.
PLAY_EVERY, LONG_PLAY_EVERY = 10, 4_000
BASIS_RATE_HZ = 2_000
LENGTHS_US = (5_000, 20_000, 100_000, 200_000)
LONG = 3
CLICKS = Clicks(
    BASIS_RATE_HZ,
    [
        np.sin(np.pi * np.linspace(0.0, 1.0, length_us * BASIS_RATE_HZ // 1_000_000 + 1)).round(9)[:, None]
        * [1.0, -1.0]
        for length_us in LENGTHS_US
    ],
)
REFUSALS = ("crc", "framing", "length", "overrun")


def _length_us(waveform: PlayedWaveform) -> int:
    return (len(waveform.samples) - 1) * US_PER_S // waveform.sample_rate_hz


@dataclass
class Figures:
    """What happened; `commands` were given to the link while it was ready, the rest had no device.

    `plays` are those of them that were clicks, `ended_plays` those that played to their end.
    """

    commands: int = 0
    plays: int = 0
    applied_commands: int = 0
    applied_plays: int = 0
    ended_plays: int = 0
    greatest_age_us: int = 0
    sessions: int = 0
    link_errors: int = 0
    written_frames: int = 0
    received: Counter[str] = field(default_factory=Counter)
    """Frames that devices took, by message and outcome."""
    device: Counter[str] = field(default_factory=Counter)
    """Counters of every boot, added up."""
    host: dict[str, int] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)


class Soak:
    """A link, a faulty device and a clock that jumps from event to event."""

    def __init__(self, faults: str, seed: int) -> None:
        plan = parse_fault_plan(faults)
        self.device = FaultyDevice(lambda boot_id: EmulatedFirmware(DeviceConfiguration(boot_id)), plan, seed)
        self.link = Link(
            LinkConfiguration(
                2, lease_ms=LEASE_MS, bit_rate_hz=BIT_RATE_HZ, handshake_timeout_s=2.0, basis=CLICKS.basis
            )
        )
        self.figures = Figures()
        self._now_us = 0
        self._reconnect_us: int | None = 0
        self._command_us: int | None = 0
        self._given_us: list[int] = []
        self._plays_given_us: list[int] = []
        self._play_end_us: int | None = None
        self._greeted_boots: set[int] = set()
        self._boots_done = 0
        self._heard = self.device.core

    def run(self, duration_s: float) -> Figures:
        """Drive for so long, then let everything on the line arrive, and sum up."""
        self._run_until(round(duration_s * US_PER_S))
        self.link.disconnect()
        self._reconnect_us = self._command_us = None
        self._run_until(self._now_us + 2 * US_PER_S)
        self._sum_up()
        return self.figures

    def _run_until(self, end_us: int) -> None:
        while self._now_us < end_us:
            self._now_us = min(end_us, max(self._now_us, self._next_us(end_us)))
            self._step()

    def _next_us(self, end_us: int) -> int:
        link_ns = self.link.next_deadline_ns()
        link_us = None if link_ns is None else -(-link_ns // NS_PER_US) - HOST_START_US
        times_us = (self._command_us, self._reconnect_us, link_us, self.device.next_deadline_us())
        return min((time_us for time_us in times_us if time_us is not None), default=end_us)

    def _step(self) -> None:
        if self._command_us is not None and self._now_us >= self._command_us:
            self._command_us += US_PER_S // COMMANDS_PER_S
            self._command()
        self._hear(self.device.run_until(self._now_us))
        if self._reconnect_us is not None and self._now_us >= self._reconnect_us:
            self._connect()
        data = self.link.outgoing(self._host_ns())
        if data:
            self.figures.written_frames += len(list(filter(None, data.split(b"\0"))))
            self._hear(self.device.receive(data, self._now_us))
        self._look_at_the_device()

    def _command(self) -> None:
        """A drive that no other equals, so that what is applied tells when it was given."""
        if self.link.state is not LinkState.READY:
            return
        if (len(self._given_us) + len(self._plays_given_us)) % PLAY_EVERY == PLAY_EVERY - 1:
            self._play()
        else:
            phase, frequency = divmod(len(self._given_us), FREQUENCIES)
            words = (LOWEST_FREQUENCY + frequency, FULL_SCALE_WORD, phase)
            self._given_us.append(self._now_us)
            self.link.set_drive(struct.pack("<6H", *words, *words))

    def _play(self) -> None:
        """Likewise, by click and amplitude; a long one is left alone until it has ended."""
        number = len(self._plays_given_us)
        is_left_alone = number % (LONG_PLAY_EVERY // PLAY_EVERY) == 0
        index = LONG if is_left_alone else number % LONG
        self._plays_given_us.append(self._now_us)
        self.link.set_play(CLICKS.encoded(index, (number + 1) / FULL_SCALE_WORD))
        if is_left_alone and self._command_us is not None:
            self._command_us += LENGTHS_US[LONG] + 2 * LEASE_MS * 1_000

    def _connect(self) -> None:
        self._reconnect_us = None if self.device.is_plugged else self._now_us + RECONNECT_US
        if self.device.is_plugged:
            self.figures.sessions += 1
            self.link.connect(self._host_ns())

    def _hear(self, data: bytes) -> None:
        try:
            self.link.receive(data, self._host_ns())
            self.link.poll(self._host_ns())
        except LinkError:
            self.figures.link_errors += 1
        if not self.device.is_plugged:
            self.link.disconnect()
        if self._reconnect_us is None and self._command_us is not None and self.link.next_deadline_ns() is None:
            self._reconnect_us = self._now_us + RECONNECT_US
        if self.link.capabilities is not None and self.link.state is LinkState.READY:
            self._greeted_boots.add(self.link.capabilities.boot_id)

    def _look_at_the_device(self) -> None:
        for boot in self.device.boots[self._boots_done :]:
            firmware = boot.core
            if firmware is not self._heard:
                self._heard, self._play_end_us = firmware, None
            for event in firmware.drive_log:
                waveform = event.waveform
                self._play_end_us = None if waveform is None else self._now_us + _length_us(waveform)
                if event.cause in (Cause.SET, Cause.PLAY):
                    self._check_age(waveform or event.channels[0])
                    assert firmware.configuration.boot_id in self._greeted_boots, "old traffic drives a new boot"
            self.figures.received.update(f"{frame.message} {frame.outcome}" for frame in firmware.received)
            firmware.drive_log.clear()
            firmware.received.clear()
        self._boots_done = len(self.device.boots) - 1
        has_power = self.device.counters.reboots < len(self.device.boots)
        if has_power and self._play_end_us is not None and self._now_us > self._play_end_us + CLOCK_SLACK_US:
            assert self.device.core.state is not DeviceState.DRIVING, "a waveform sounds beyond its end"
            self.figures.ended_plays += 1
            self._play_end_us = None

    def _check_age(self, command: ChannelTarget | PlayedWaveform) -> None:
        age_us = self._now_us - self._given(command)
        assert age_us <= AGE_BOUND_US, f"a command {age_us} us old is applied"
        self.figures.applied_commands += 1
        self.figures.applied_plays += isinstance(command, PlayedWaveform)
        self.figures.greatest_age_us = max(self.figures.greatest_age_us, age_us)

    def _given(self, command: ChannelTarget | PlayedWaveform) -> int:
        if isinstance(command, PlayedWaveform):
            return self._plays_given_us[round(command.amplitude * FULL_SCALE_WORD) - 1]
        assert command.phase_rad is not None
        phase = round(command.phase_rad / math.tau * WORDS_PER_TURN)
        return self._given_us[phase * FREQUENCIES + round(command.frequency_hz / RESOLUTION_HZ) - LOWEST_FREQUENCY]

    def _host_ns(self) -> int:
        return (HOST_START_US + self._now_us) * NS_PER_US

    def _sum_up(self) -> None:
        figures = self.figures
        figures.plays = len(self._plays_given_us)
        figures.commands = len(self._given_us) + figures.plays
        for boot in self.device.boots:
            figures.device.update(asdict(boot.core.counters))
            figures.device.update(asdict(boot.core.framing_counters))
        figures.host = asdict(self.link.counters) | asdict(self.link.framing_counters)
        figures.faults = self.device.fault_counts()


def check_that_counters_reconcile(figures: Figures) -> None:
    """Every frame is accounted for, from the host's write to what the device did with it, and back."""
    faults, device, received = figures.faults, figures.device, figures.received
    assert faults["to_device.frames"] == figures.written_frames
    for line, receiver in (("to_device", device), ("to_host", Counter(figures.host))):
        went_in = faults[f"{line}.frames"] + faults[f"{line}.duplicated"]
        assert went_in == sum(faults[f"{line}.{kind}"] for kind in ("dropped", "unheard", "lost", "delivered"))
        assert receiver["ok"] == faults[f"{line}.intact"]
        assert sum(receiver[kind] for kind in REFUSALS) == faults[f"{line}.damaged"]
    assert sum(received.values()) == device["ok"]
    assert device["applied"] == received["SET accepted"] + received["PLAY accepted"]
    assert figures.applied_plays == received["PLAY accepted"]
    for outcome in ("stale", "refused"):
        assert device[outcome] == sum(count for name, count in received.items() if name.endswith(f" {outcome}"))
    link, copies = figures.host, faults["to_device.duplicated"]
    sets, plays, kept_alive = (
        sum(received[f"{name} {outcome}"] for outcome in ("accepted", "stale", "refused"))
        for name in ("SET", "PLAY", "KEEPALIVE")
    )
    assert plays <= figures.plays + copies
    assert sets + plays <= link["sent"] + link["renewed"] + copies
    assert kept_alive <= link["kept_alive"] + copies
    assert link["sent"] + link["coalesced"] + link["dropped"] <= figures.commands
    assert figures.applied_commands <= link["sent"]
