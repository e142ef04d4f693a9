"""Device behind a faulty serial line: used like the device itself, it injects the faults of a plan."""

import random
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Generic, Protocol, TypeVar

from firmware_link.emulator.fault_plan import FaultPlan, TimedKind
from firmware_link.emulator.faulty_line import FaultyLine

BILLION = 1_000_000_000
AT_NOISE = b"AT\rATE0 V1\rAT+GCAP\r"  # what ModemManager says to a new port


class Core(Protocol):
    """A device without I/O: `EmulatedFirmware`, or the reference firmware itself."""

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that came at a device time; returns what the device says until then."""

    def run_until(self, now_us: int) -> bytes:
        """Let time pass; returns what the device says until then."""

    def hang_up(self, now_us: int) -> bytes:
        """The host let go of the line; returns what the device says until then."""

    def next_deadline_us(self) -> int | None:
        """Time at which the device acts by itself next; None while it waits."""


C = TypeVar("C", bound=Core)


@dataclass(frozen=True)
class Boot(Generic[C]):
    """The device from one boot to the next; its clock was 0 at `booted_us` of the line's."""

    booted_us: int
    core: C


@dataclass
class TimedCounters:
    """Number of injected faults that have a time."""

    hang_ups: int = 0
    reboots: int = 0
    at_noises: int = 0


class FaultyDevice(Generic[C]):
    """A core behind two lines; `start` makes a core for a boot id. Times are those of the line, in microseconds.

    Time must not run backwards. `boots` has every boot of the device; the last one is the present.
    """

    def __init__(self, start: Callable[[int], C], plan: FaultPlan, seed: int) -> None:
        self.plan = plan
        self.counters = TimedCounters()
        self.to_device = FaultyLine(plan, f"{seed} to device", can_be_half_open=False)
        self.to_host = FaultyLine(plan, f"{seed} to host", can_be_half_open=True)
        self._events = [fault for fault in plan.timed if fault.kind in (TimedKind.REBOOT, TimedKind.HANG_UP)]
        self._start = start
        self._boot_ids = random.Random(f"{seed} boots")
        self.boots = [Boot(0, self._start_core())]
        self._now_us = 0
        self._since_us = 0
        self._powered_us: int | None = None
        self._plugged_us: int | None = None
        self._is_open = False

    @property
    def core(self) -> C:
        """The device of the present boot."""
        return self.boots[-1].core

    @property
    def is_plugged(self) -> bool:
        """Whether the port is there."""
        return self._plugged_us is None

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that the host wrote at `now_us`; returns what reaches it until then."""
        self._advance(now_us)
        if not self._is_open and self.plan.at_noise:
            self.counters.at_noises += 1
            self.to_device.push_noise(AT_NOISE, now_us)
        self._is_open = True
        self.to_device.push(data, now_us)
        return self.run_until(now_us)

    def run_until(self, now_us: int) -> bytes:
        """Let time pass up to `now_us`; returns what reaches the host until then."""
        self._advance(now_us)
        return self.to_host.pop(now_us)

    def hang_up(self, now_us: int) -> None:
        """The host let go of the line."""
        self._advance(now_us)
        self._hang_up()

    def unplug(self, now_us: int, duration_us: int) -> None:
        """Pull the cable for a while; the device keeps its power."""
        self._advance(now_us)
        self._hang_up()
        self._plugged_us = now_us + duration_us

    def reboot(self, now_us: int) -> None:
        """Power off and on."""
        self._advance(now_us)
        self._power_off(0)
        self._advance(now_us)

    def next_deadline_us(self) -> int | None:
        """Time of the next event that needs no host, or None if no such event is due."""
        times_us = (self._next_inner_us(), self.to_host.next_us())
        return min((time_us for time_us in times_us if time_us is not None), default=None)

    def fault_counts(self) -> dict[str, int]:
        """Every counter, by direction and kind."""
        lines = {"to_device": self.to_device.counters, "to_host": self.to_host.counters}
        counts = {f"{name}.{kind}": number for name, line in lines.items() for kind, number in asdict(line).items()}
        return counts | asdict(self.counters)

    def _advance(self, now_us: int) -> None:
        while (next_us := self._next_inner_us()) is not None and next_us <= now_us:
            self._now_us = max(self._now_us, next_us)
            self._act()
        self._now_us = max(self._now_us, now_us)
        if self._powered_us is None:
            self._say(self.core.run_until(self._device_us()))

    def _next_inner_us(self) -> int | None:
        times_us = [self.to_device.next_us(), self._powered_us, self._plugged_us, self._core_deadline_us()]
        times_us += [fault.begins_us(self._since_us) for fault in self._events]
        return min((time_us for time_us in times_us if time_us is not None), default=None)

    def _act(self) -> None:
        now_us = self._now_us
        if self._powered_us is not None and self._powered_us <= now_us:
            self._powered_us = None
            self.boots.append(Boot(now_us, self._start_core()))
        if self._plugged_us is not None and self._plugged_us <= now_us:
            self._plugged_us = None
        due = [fault for fault in self._events if fault.begins_us(self._since_us) == now_us]
        self._since_us = now_us + 1
        for fault in due:
            if fault.kind is TimedKind.REBOOT:
                self._power_off(fault.duration_us)
            else:
                self.counters.hang_ups += 1
                self._hang_up()
                self._plugged_us = now_us + fault.duration_us
        if self._powered_us is not None:
            self.to_device.lose()
            return
        arrived = self.to_device.pop(now_us)
        self._say(self.core.receive(arrived, self._device_us()) if arrived else self.core.run_until(self._device_us()))

    def _power_off(self, duration_us: int) -> None:
        self.counters.reboots += 1
        self._powered_us = self._now_us + duration_us
        self.to_device.lose()
        self.to_device.forget()

    def _hang_up(self) -> None:
        self.to_device.lose()
        if self._powered_us is None:
            self.core.hang_up(self._device_us())
        self.to_host.lose()
        self._is_open = False

    def _say(self, data: bytes) -> None:
        if data:
            self.to_host.push(data, self._now_us)
            if not self._is_open:
                self.to_host.lose()

    def _start_core(self) -> C:
        return self._start(self._boot_ids.getrandbits(32))

    def _device_us(self) -> int:
        return (self._now_us - self.boots[-1].booted_us) * (BILLION + self.plan.drift_ppb) // BILLION

    def _core_deadline_us(self) -> int | None:
        deadline_us = None if self._powered_us is not None else self.core.next_deadline_us()
        if deadline_us is None:
            return None
        return self.boots[-1].booted_us - (-deadline_us * BILLION // (BILLION + self.plan.drift_ppb))
