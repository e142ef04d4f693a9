"""A session of many minutes in virtual time, with faults: nothing stale is applied, and every counter reconciles.

`python -m tests.firmware_link.soak SECONDS [FAULTS] [SEED]` drives at 1000 commands a second and prints the figures.
"""

import argparse
import json
import math
import struct
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from firmware_link.device import DeviceConfiguration, EmulatedFirmware
from firmware_link.drive_log import Cause, ChannelTarget
from firmware_link.errors import LinkError
from firmware_link.fault_plan import parse_fault_plan
from firmware_link.faulty_device import FaultyDevice
from firmware_link.link import Link
from firmware_link.link_values import LinkConfiguration, LinkState
from firmware_link.messages import FULL_SCALE_WORD, WORDS_PER_TURN

FAULTS = (
    "bit_errors=1e-5,drop=0.005,duplicate=0.005,insert=0.0005,lose=0.0005,burst=0.0005,delay=300us,jitter=1ms,"
    "drift=40ppm,stall=0.05s/7s,stall=0.3s/61s,half_open=1.5s/83s,hang_up=0.4s/127s,reboot=0.2s/173s,at_noise"
)
COMMANDS_PER_S = 1_000
BIT_RATE_HZ = 2_000_000
LEASE_MS = 40
US_PER_S = 1_000_000
NS_PER_US = 1_000
RECONNECT_US = 100_000
# The oldest that an applied command may be: one lease by the device's clock, and what the host errs about that clock.
AGE_BOUND_US = LEASE_MS * 1_000 + 2_000
HOST_START_US = 77_000_000_000
# Commands are numbered by their words of frequency and phase.
LOWEST_FREQUENCY, FREQUENCIES = 100, 1 << 15
RESOLUTION_HZ = 0.01
REFUSALS = ("crc", "framing", "length", "overrun")


@dataclass
class Figures:
    """What happened; `commands` were given to the link while it was ready, the rest had no device."""

    commands: int = 0
    applied_commands: int = 0
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
        self.link = Link(LinkConfiguration(2, lease_ms=LEASE_MS, bit_rate_hz=BIT_RATE_HZ, handshake_timeout_s=2.0))
        self.figures = Figures()
        self._now_us = 0
        self._reconnect_us: int | None = 0
        self._command_us: int | None = 0
        self._given_us: list[int] = []
        self._greeted_boots: set[int] = set()
        self._boots_done = 0

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
        self._hear(self.device.advance(self._now_us))
        if self._reconnect_us is not None and self._now_us >= self._reconnect_us:
            self._connect()
        data = self.link.outgoing(self._host_ns())
        if data:
            self.figures.written_frames += len(list(filter(None, data.split(b"\0"))))
            self._hear(self.device.receive(data, self._now_us))
        self._look_at_the_device()

    def _command(self) -> None:
        """A drive that no other equals, so that what is applied tells when it was given."""
        if self.link.state is LinkState.READY:
            phase, frequency = divmod(len(self._given_us), FREQUENCIES)
            words = (LOWEST_FREQUENCY + frequency, FULL_SCALE_WORD, phase)
            self._given_us.append(self._now_us)
            self.link.set_drive(struct.pack("<6H", *words, *words))

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
            for event in firmware.drive_log:
                if event.cause is Cause.SET:
                    self._check_age(event.channels[0])
                    assert firmware.configuration.boot_id in self._greeted_boots, "old traffic drives a new boot"
            self.figures.received.update(f"{frame.message} {frame.outcome}" for frame in firmware.received)
            firmware.drive_log.clear()
            firmware.received.clear()
        self._boots_done = len(self.device.boots) - 1

    def _check_age(self, channel: ChannelTarget) -> None:
        assert channel.phase_rad is not None
        phase = round(channel.phase_rad / math.tau * WORDS_PER_TURN)
        frequency = round(channel.frequency_hz / RESOLUTION_HZ) - LOWEST_FREQUENCY
        age_us = self._now_us - self._given_us[phase * FREQUENCIES + frequency]
        assert age_us <= AGE_BOUND_US, f"a command {age_us} us old is applied"
        self.figures.applied_commands += 1
        self.figures.greatest_age_us = max(self.figures.greatest_age_us, age_us)

    def _host_ns(self) -> int:
        return (HOST_START_US + self._now_us) * NS_PER_US

    def _sum_up(self) -> None:
        figures = self.figures
        figures.commands = len(self._given_us)
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
    assert device["applied"] == received["SET accepted"]
    for outcome in ("stale", "refused"):
        assert device[outcome] == sum(count for name, count in received.items() if name.endswith(f" {outcome}"))
    link = figures.host
    sets = sum(received[f"SET {outcome}"] for outcome in ("accepted", "stale", "refused"))
    assert sets <= link["sent"] + link["renewed"] + faults["to_device.duplicated"]
    assert link["sent"] + link["coalesced"] + link["dropped"] <= figures.commands
    assert figures.applied_commands <= link["sent"]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", type=float)
    parser.add_argument("faults", nargs="?", default=FAULTS)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    arguments = parser.parse_args()
    started_s = time.monotonic()
    figures = Soak(arguments.faults, arguments.seed).run(arguments.seconds)
    check_that_counters_reconcile(figures)
    took_s = round(time.monotonic() - started_s, 1)
    document: dict[str, Any] = {"faults": arguments.faults, "took_s": took_s, "figures": vars(figures)}
    json.dump(document, sys.stdout, indent=2)
    sys.stdout.write("\n")


if __name__ == "__main__":
    main()
