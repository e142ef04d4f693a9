"""Minutes of recorded touch through the loop in virtual time: memory stays, no lease runs out, nothing is collected."""

from __future__ import annotations

import gc
import math
import resource
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from engine.effects.rules import Effects, Rule, Trigger, burst
from engine.loop.dispatcher import Dispatcher
from engine.loop.loop import Loop, connect
from engine.loop.observer import Timing
from engine.loop.pipeline import open_pipeline
from engine.loop.realtime import Step, real_time
from engine.render.limits import link_configuration
from engine.touch.sources.recording import Playback, Recording, read_recording
from firmware_link.emulator.device_state import DeviceCounters
from firmware_link.emulator.drive_log import Cause
from firmware_link.host.link import Link
from firmware_link.host.session import Session
from tactable.shipped import DEMO_RECORDING, find_device
from tests.engine.made_table import LEVEL_DB
from tests.engine.render.made_steady import made_renderer
from tests.tools.virtual import VirtualLine

DEVICE = find_device("reference-a")
BURSTS = Effects((Rule(Trigger.TOUCH, burst(LEVEL_DB, 50)),))
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


def repeated(recording: Recording, seconds: float) -> Recording:
    """Again and again for a time, with a pause between."""
    period_s = recording.reports[-1].time_s + PAUSE_S
    reports = [
        replace(report, time_s=report.time_s + period_s * turn)
        for turn in range(math.ceil(seconds / period_s))
        for report in recording.reports
    ]
    return replace(recording, reports=tuple(reports))


@dataclass
class Day:
    """What was found; memory after each piece."""

    reports: int = 0
    commands: int = 0
    renewals: int = 0
    expired_leases: int = 0
    counters: DeviceCounters = field(default_factory=DeviceCounters)
    collections: int = 0
    unreachable: int = 0
    memory_mib: list[float] = field(default_factory=list)


def memory_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def replay(recording: Recording, seconds: float, pieces: int) -> Day:
    """The recording for a time, in pieces; one session from the first to the last."""
    gc.collect()  # what was left before is not of this day
    machine, day = Machine(), Day()
    session = Session(Link(link_configuration(DEVICE, 1_000_000)), machine, machine.now_ns)
    collections: list[str] = []

    def note(phase: str, _: dict[str, int]) -> None:
        collections.append(phase)

    for _ in range(pieces):
        capabilities = connect(session, machine)
        source = Playback(repeated(recording, seconds / pieces))
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
        day.expired_leases, day.counters = machine.expired, replace(machine.firmware.counters)
        assert machine.firmware.counters.trips == trips
        day.reports += loop.counters.reports
        day.commands += loop.counters.commands
        day.unreachable += gc.collect()
        day.memory_mib.append(memory_mib())
    day.renewals, day.collections = session.link.counters.renewed, len(collections)
    return day


def test_no_lease_runs_out_and_nothing_is_collected() -> None:
    day = replay(read_recording(DEMO_RECORDING), 40.0, 2)
    assert day.reports > 3_000
    assert day.commands > 50
    assert day.renewals > 250
    assert day.expired_leases == 0
    assert (day.counters.stale, day.counters.refused) == (0, 0)
    assert day.collections == 0
    assert day.unreachable == 0  # no cycles: nothing waits for a collector that never comes


@pytest.mark.long
def test_memory_stays() -> None:
    day = replay(read_recording(DEMO_RECORDING), 160.0, 8)
    # By the sixth piece as many drives are remembered as ever will be.
    assert day.memory_mib[-1] == pytest.approx(day.memory_mib[5], abs=2.0)
