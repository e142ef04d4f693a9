"""Minutes of recorded touch through the loop in virtual time: memory stays, no lease runs out, nothing is collected."""

from __future__ import annotations

import gc
import resource
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from engine.effects.rules import Effects, Rule, Trigger, burst
from engine.loop.dispatcher import Dispatcher
from engine.loop.loop import Loop, connect
from engine.loop.observer import Timing
from engine.loop.pipeline import open_pipeline
from engine.loop.realtime import Step, real_time
from engine.render.limits import link_configuration
from engine.touch.sources.recording import Recording, Report, read_recording
from firmware_link.emulator.device_state import DeviceCounters
from firmware_link.emulator.drive_log import Cause
from firmware_link.host.link import Link
from firmware_link.host.session import Session
from tactable.shipped import DEMO_RECORDING, find_device
from tests.engine.made_states import LEVEL_DB
from tests.engine.render.made_steady import made_renderer
from tests.tools.virtual import VirtualLine

DEVICE = find_device("reference-a")
BURSTS = Effects((Rule(Trigger.TOUCH, burst(LEVEL_DB, 50)),))
NS_PER_S = 1_000_000_000
PAUSE_S = 1.0
LOGGED = 1_000


class Machine(VirtualLine):
    """A virtual line whose logs are counted and forgotten."""

    expired = 0

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int] | None:
        found = super().wait(until_ns, readable, writable)
        self.written.clear()
        log, received = self.firmware.drive_log, self.firmware.received
        if len(log) + len(received) > LOGGED:
            self.expired += sum(event.cause is Cause.LEASE_EXPIRED for event in log)
            log.clear()
            received.clear()
        return found


class Repeated:
    """A recording as a Source, again and again until a time, with a pause between."""

    def __init__(self, recording: Recording, clock: Machine, stop_ns: int) -> None:
        self.name, self.descriptor, self.report_id = recording.name, recording.descriptor, None
        self.vendor_id, self.product_id = recording.vendor_id, recording.product_id
        self.report_index, self.report_time_ns = -1, 0
        self._reports: tuple[Report, ...] = recording.reports
        self._times_ns = [round(NS_PER_S * report.time_s) for report in recording.reports]
        self._start_ns, self._stop_ns, self._next = clock.time_ns, stop_ns, 0

    @property
    def ended(self) -> bool:
        return self._start_ns >= self._stop_ns

    def fileno(self) -> None:
        return None

    def next_time_ns(self) -> int | None:
        return None if self.ended else self._start_ns + self._times_ns[self._next]

    def read(self, now_ns: int) -> bytes | None:
        due_ns = self.next_time_ns()
        if due_ns is None or now_ns < due_ns:
            return None
        self.report_index, self.report_time_ns = self.report_index + 1, due_ns
        data = self._reports[self._next].data
        self._next += 1
        if self._next == len(self._reports):
            self._next = 0
            self._start_ns = due_ns + round(PAUSE_S * NS_PER_S)
        return data

    def source_time_ns(self, now_ns: int) -> int:
        return now_ns

    def clock_time_ns(self, source_time_ns: int) -> int:
        return source_time_ns


@dataclass
class Day:
    """What was found; memory after each piece."""

    reports: int = 0
    frames: int = 0
    commands: int = 0
    renewals: int = 0
    expired_leases: int = 0
    counters: DeviceCounters | None = None
    collections: int = 0
    unreachable: int = 0
    memory_mib: tuple[float, ...] = ()


def memory_mib() -> float:
    """What the process has in memory now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def replay(recording: Recording, seconds: float, pieces: int) -> Day:
    """The recording for a time, in pieces; one session from the first to the last."""
    gc.collect()  # what was left before is not of this day
    machine, day = Machine(), Day(counters=DeviceCounters())
    link = Link(link_configuration(DEVICE, 1_000_000))
    session = Session(link, machine, machine.now_ns)
    collections: list[str] = []

    def note(phase: str, _: dict[str, int]) -> None:
        collections.append(phase)

    memory = list[float]()
    for _ in range(pieces):
        capabilities = connect(session, machine)
        source = Repeated(recording, machine, machine.time_ns + round(seconds / pieces * NS_PER_S))
        pipeline = open_pipeline(source, DEVICE, BURSTS, made_renderer(DEVICE, capabilities))
        loop = Loop(pipeline, Dispatcher(session, machine.now_ns), source, machine, Timing())
        trips = machine.firmware.counters.trips
        with real_time([Step.COLLECTOR]):
            gc.callbacks.append(note)
            try:
                loop.run()
            finally:
                gc.callbacks.remove(note)
        # A run ends with STOP, which is none.
        day.expired_leases += machine.expired
        machine.expired = 0
        day.counters = replace(machine.firmware.counters)
        assert machine.firmware.counters.trips == trips
        day.reports += loop.counters.reports
        day.frames += loop.counters.frames
        day.commands += loop.counters.commands
        day.unreachable += gc.collect()
        memory.append(memory_mib())
    day.renewals, day.collections = link.counters.renewed, len(collections)
    day.memory_mib = tuple(memory)
    return day


def test_no_lease_runs_out_and_nothing_is_collected() -> None:
    day = replay(read_recording(DEMO_RECORDING), 40.0, 2)
    assert day.reports > 3_000
    assert day.commands > 50
    assert day.renewals > 250
    assert day.expired_leases == 0
    assert day.counters is not None
    assert (day.counters.stale, day.counters.refused) == (0, 0)
    assert day.collections == 0
    assert day.unreachable == 0  # no cycles: nothing waits for a collector that never comes


@pytest.mark.long
def test_memory_stays() -> None:
    day = replay(read_recording(DEMO_RECORDING), 160.0, 8)
    # By the sixth piece as many drives are remembered as ever will be.
    assert day.memory_mib[-1] == pytest.approx(day.memory_mib[5], abs=2.0)
