"""A condition to one segment of measurement: the stamps of its commands, and whether everything came, in order."""

import contextlib
import os
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.loop.latency import Stage
from engine.loop.realtime import Outcome, Step, real_time
from engine.table import Table
from firmware_link.emulator.process import RunningEmulator, run_emulator
from firmware_link.protocol.errors import LinkError
from tactable.bench.inputs import Stream, expected_states
from tactable.bench.latency.engine import SOCKET_BIT_RATE_HZ, EngineProcess, Segment
from tactable.bench.latency.floor import read_echo_samples, start_echo_engine
from tactable.bench.latency.load import Load
from tactable.bench.latency.source import LEAD_NS, Apparatus, Echoed, Schedule, Stall
from tactable.bench.latency.stages import Point, Stamps
from tactable.bench.light_device import Arrivals, LightDevice

Times = NDArray[np.int64]

TACTABLE, ECHO = "tactable", "C echo"
LONG_WAY = "tactable without fast path"
PTY_BIT_RATE_HZ = 2_000_000
# A SET comes within a fraction of a lease, or a stall of the line; its sequence comes again after 256 frames.
_LONGEST_WAY_NS = 200_000_000
# Device time is cut to whole microseconds.
_CUT_NS = 1_000
# Small: a line that stands still is to be noticed, as one frame in flight is on a real one.
_LINK_BUFFER_BYTES = 2_048
_TOUCH_BUFFER_BYTES = 1 << 20


@dataclass(frozen=True)
class Condition:
    """Which engine, how fast, beside what, and with which real-time steps."""

    engine: str
    rate_hz: int
    load: Load
    steps: tuple[Step, ...]

    @property
    def steps_text(self) -> str:
        """Such as "all", "none" or "all but memory"."""
        missing = [step for step in Step if step not in self.steps]
        if not self.steps:
            return "none"
        return f"all but {', '.join(missing)}" if missing else "all"

    @property
    def name(self) -> str:
        """For people, and as a key."""
        return f"{self.engine}, {self.rate_hz}/s, {self.load}, steps {self.steps_text}"


@dataclass(frozen=True)
class Way:
    """What the commands go over: a socket pair, an emulated firmware behind a pseudo-terminal, or a given port."""

    name: str
    """`sockets`, `pty`, or the name of a port."""
    bit_rate_hz: int = SOCKET_BIT_RATE_HZ

    @property
    def is_sockets(self) -> bool:
        """Whether there is no driver in between."""
        return self.name == "sockets"

    @property
    def is_pty(self) -> bool:
        """Whether an emulator is started for it."""
        return self.name == "pty"


@dataclass
class Measured:
    """One segment: stamps of its commands, and what became of all reports."""

    stamps: Stamps
    due_ns: Times
    facts: dict[str, Any] = field(default_factory=dict)
    outcomes: tuple[Outcome, ...] = ()


class Bench:
    """Runs segments, one after another; its engine's process lives as long as it. Use it in a `with` block.

    `streams` has the touches for each rate; without `echo` there is no C echo engine to run.
    """

    def __init__(self, table: Table, streams: Mapping[int, Stream], folder: Path, way: Way, echo: Path | None) -> None:
        self._table, self._streams, self._folder, self._way, self._echo = table, streams, folder, way, echo
        self._device: Device = table.device
        self._processors = _processors()
        self._stack = ExitStack()
        self.apparatus_outcomes: tuple[Outcome, ...] = ()

    def __enter__(self) -> "Bench":
        self._engine = EngineProcess(self._table.path)
        self._stack.callback(self._engine.close)
        # What measures must not be what waits; the sleep of processors is part of what is measured.
        steps = (Step.PRIORITY, Step.MEMORY, Step.AFFINITY, Step.COLLECTOR)
        self.apparatus_outcomes = self._stack.enter_context(real_time(steps, processor=self._processors[0]))
        return self

    def __exit__(self, *unused: object) -> None:
        self._stack.close()

    def measure(self, condition: Condition, seconds: float, stall: Stall | None = None) -> Measured:
        """One segment. Raises LinkError where the engine, the port or its device fails."""
        stream = self._streams[condition.rate_hz]
        count = max(1, round(condition.rate_hz * seconds))
        if condition.engine == ECHO:
            return self._measure_echo(condition, stream, count)
        return self._measure_engine(condition, stream, count, stall)

    def _measure_engine(self, condition: Condition, stream: Stream, count: int, stall: Stall | None) -> Measured:
        path = self._folder / "segment.npz"
        with ExitStack() as stack:
            touch, their_touch = _touch_pair(stack)
            emulator = stack.enter_context(run_emulator(len(self._device.actuators))) if self._way.is_pty else None
            link, their_link, device = None, None, None
            if self._way.is_sockets:
                link, their_link = _link_pair(stack)
                device = LightDevice(len(self._device.actuators), time.monotonic_ns())
            segment = self._segment(condition, stream, count, path, emulator)
            self._engine.begin(segment, their_touch, their_link)
            _let_go(their_touch, their_link)
            idle = Schedule(iter(()), 1.0, 0, 0)
            Apparatus(idle, touch, link, device, keeps_open=True).run(self._engine.fileno())
            armed = self._engine.answer()
            schedule = Schedule(stream.packets(), condition.rate_hz, count, time.monotonic_ns() + LEAD_NS)
            apparatus = Apparatus(schedule, touch, link, device, stall=stall, engine_process_id=self._engine.process_id)
            apparatus.run(self._engine.fileno())
            answer = self._engine.answer()
            arrivals = device.arrivals if device else _arrivals_of(emulator) if emulator else Arrivals()
        with np.load(path) as arrays:
            samples = {name: arrays[name] for name in arrays.files}
        stamps, due_ns = _stamps_of(samples, arrivals, schedule)
        if stream.reports_per_command is not None:
            replaced, replaced_due_ns = _replaced(samples, schedule)
            stamps, due_ns = np.concatenate([stamps, replaced]), np.concatenate([due_ns, replaced_due_ns])
        measured = Measured(stamps, due_ns)
        measured.outcomes = tuple(Outcome(Step(o["step"]), o["finding"], o["remedy"]) for o in answer["outcomes"])
        measured.facts = self._facts(answer, samples, schedule, stream) | {"board": armed["board"]}
        return measured

    def _segment(
        self, condition: Condition, stream: Stream, count: int, path: Path, emulator: RunningEmulator | None
    ) -> Segment:
        port = emulator.port if emulator else None if self._way.is_sockets else self._way.name
        return Segment(
            stream.descriptor.hex(),
            stream.vendor_id,
            stream.product_id,
            count,
            tuple(map(str, condition.steps)),
            self._processors[-1],
            condition.load is Load.THREAD,
            str(path),
            port,
            self._way.bit_rate_hz,
            condition.engine != LONG_WAY,
        )

    def _facts(
        self, answer: dict[str, Any], samples: dict[str, Times], schedule: Schedule, stream: Stream
    ) -> dict[str, Any]:
        by_reports = samples["change_report"] >= 0
        reports, states = (samples[name][by_reports].tolist() for name in ("change_report", "change_state"))
        expected = expected_states(stream, schedule.count, self._device)
        expired = answer["digitizer"]["expired_frames"]
        lower_ns, upper_ns = answer["clock_bounds_ns"]
        return {
            "reports_sent": schedule.next,
            "reports_lost": schedule.next - answer["loop"]["reports"],
            "commands": answer["loop"]["commands"],
            "answered_by_fast_path": answer["loop"]["answered"],
            "mispredicted": answer["loop"]["mispredicted"],
            "sessions_lost": answer["loop"]["reconnects"],
            "replaced_unsent": answer["link"]["coalesced"],
            "stale_sent": _stale(samples),
            "order_kept": None if expired else [*zip(reports, states, strict=True)] == expected,
            "released_by_watchdog": expired,
            "clock_bounds_us": (upper_ns - lower_ns) / 1e3,
        }

    def _measure_echo(self, condition: Condition, stream: Stream, count: int) -> Measured:
        assert self._echo is not None  # the plan has no echo where there is none
        path, every = self._folder / "echo.bin", stream.reports_per_command or 1
        with ExitStack() as stack:
            touch, their_touch = _touch_pair(stack)
            link, their_link = _link_pair(stack)
            awake = [step for step in condition.steps if step is Step.DMA_LATENCY]
            outcomes = stack.enter_context(real_time(awake))
            descriptors = (their_touch.fileno(), their_link.fileno())
            process = start_echo_engine(self._echo, *descriptors, every, path, condition.steps, self._processors[-1])
            stack.callback(_end, process)
            _let_go(their_touch, their_link)
            ended, device = stack.enter_context(_end_of(process)), Echoed()
            idle = Schedule(iter(()), 1.0, 0, 0)
            apparatus = Apparatus(idle, touch, link, device, keeps_open=True)
            apparatus.run(ended, lambda: len(device.arrivals.time_ns) > 0)
            schedule = Schedule(stream.packets(), condition.rate_hz, count, time.monotonic_ns() + LEAD_NS)
            Apparatus(schedule, touch, link, device).run(ended)
            status = process.wait()
        if status != 0:
            raise LinkError(f"the C echo engine ended with exit status {status}: leave it out with --no-echo")
        samples, received = read_echo_samples(path), np.array(device.arrivals.time_ns[1:], np.int64)
        stamps = _empty(len(samples))
        stamps[:, [Point.DUE, Point.SENT, Point.READ, Point.WRITTEN]] = samples - samples[:, :1]
        stamps[: len(received), Point.RECEIVED] = received[: len(samples)] - samples[: len(received), 0]
        facts = {"reports_sent": schedule.next, "commands": len(samples)}
        return Measured(stamps, samples[:, 0].copy(), facts, outcomes)


def _processors() -> tuple[int, int]:
    """For what measures, and for what is measured."""
    allowed = sorted(os.sched_getaffinity(0))
    return allowed[0], allowed[-1]


def _touch_pair(stack: ExitStack) -> tuple[socket.socket, socket.socket]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _TOUCH_BUFFER_BYTES)
    return stack.enter_context(ours), stack.enter_context(theirs)


def _link_pair(stack: ExitStack) -> tuple[socket.socket, socket.socket]:
    ours, theirs = socket.socketpair()
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LINK_BUFFER_BYTES)
    return stack.enter_context(ours), stack.enter_context(theirs)


def _let_go(*sockets: socket.socket | None) -> None:
    """Close this process's copies: the end of the other process is to be noticed."""
    for sock in sockets:
        if sock is not None:
            sock.close()


@contextlib.contextmanager
def _end_of(process: "subprocess.Popen[bytes]") -> Iterator[int]:
    """A descriptor that can be read once a process has ended."""
    descriptor = os.pidfd_open(process.pid)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _end(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        process.kill()
    process.wait()


def _empty(count: int) -> Stamps:
    stamps = np.full((count, len(Point)), np.nan)
    stamps[:, Point.DUE] = 0.0
    return stamps


def _stamps_of(samples: dict[str, Times], arrivals: Arrivals, schedule: Schedule) -> tuple[Stamps, Times]:
    """Every point of the commands that a report caused and that were written."""
    ours, sent_ns = samples["stamps_ns"], samples["sent_ns"]
    due_ns = ours[:, Stage.AVAILABLE]
    reports = np.rint((due_ns - schedule.start_ns) * schedule.rate_hz / 1e9).astype(np.int64)
    stamps = _empty(len(ours))
    stamps[:, Point.SENT] = sent_ns[reports] - due_ns
    stamps[:, Point.READ : Point.WRITTEN + 1] = ours[:, Stage.READ :] - due_ns[:, None]
    received_ns = first_with_sequence(
        np.array(arrivals.time_ns, np.int64),
        np.array(arrivals.sequence, np.int64),
        ours[:, Stage.COMMAND] - _CUT_NS,
        samples["sequence"],
    )
    stamps[:, Point.RECEIVED] = received_ns - due_ns
    applied_ns = _applied(samples, ours[:, Stage.COMMAND])
    stamps[:, Point.APPLIED] = applied_ns - due_ns
    stamps[:, Point.AT_FINGER] = np.fmax(stamps[:, Point.APPLIED], stamps[:, Point.RECEIVED]) + samples["promise_ns"]
    return stamps, due_ns


def _replaced(samples: dict[str, Times], schedule: Schedule) -> tuple[Stamps, Times]:
    """Changes whose command a newer one replaced unsent: answered when the next command was written, or never.

    Without them a stall would show in the few commands that were sent after it only, which are not late.
    """
    ours = samples["stamps_ns"]
    by_reports = samples["change_report"] >= 0
    reports, changes_ns = samples["change_report"][by_reports], samples["change_ns"][by_reports]
    is_sent = np.isin(changes_ns, ours[:, Stage.STATE])
    reports, changes_ns = reports[~is_sent], changes_ns[~is_sent]
    due_ns = np.array([schedule.time_of_ns(int(report)) for report in reports], np.int64)
    written_ns = np.append(ours[:, Stage.WRITTEN].astype(np.float64), np.nan)
    answered_ns = written_ns[np.searchsorted(ours[:, Stage.WRITTEN], changes_ns)]
    stamps = _empty(len(reports))
    stamps[:, Point.SENT] = samples["sent_ns"][reports] - due_ns
    stamps[:, Point.READ] = samples["read_ns"][reports] - due_ns
    stamps[:, Point.STATE] = changes_ns - due_ns
    stamps[:, Point.WRITTEN] = answered_ns - due_ns
    return stamps, due_ns


def first_with_sequence(
    times_ns: Times, sequences: Times, since_ns: Times, wanted: Times, longest_ns: int = _LONGEST_WAY_NS
) -> NDArray[np.float64]:
    """For each wanted sequence the first time, at or after its own `since_ns`, that has it; NaN within `longest_ns`.

    `times_ns` rise. Shapes (arrival,) twice, (sample,) twice; the result (sample,).
    """
    found = np.full(len(wanted), np.nan)
    for sequence in np.unique(wanted):
        rows, times = np.nonzero(wanted == sequence)[0], times_ns[sequences == sequence]
        place = np.searchsorted(times, since_ns[rows])
        is_there = place < len(times)
        rows, times = rows[is_there], times[place[is_there]]
        is_near = times - since_ns[rows] <= longest_ns
        found[rows[is_near]] = times[is_near]
    return found


def _applied(samples: dict[str, Times], since_ns: Times) -> NDArray[np.float64]:
    """When the firmware says it applied a command, on the host's clock by the middle of its bounds."""
    times_ns, sequences = samples["applied_ns"], samples["applied_sequence"]
    order = np.argsort(times_ns, kind="stable")
    # The bounds may put it before it was sent.
    slack_ns = max(_CUT_NS, int(samples["bounds_half_width_ns"]))
    return first_with_sequence(times_ns[order], sequences[order], since_ns - slack_ns, samples["sequence"])


def _arrivals_of(emulator: RunningEmulator) -> Arrivals:
    """When each SET came, by the emulated firmware's own clock, which is the host's."""
    arrivals, log = Arrivals(), emulator.log()
    for frame in log.received:
        if frame.message == "SET":
            arrivals.time_ns.append(log.host_ns_at_device_zero + 1_000 * frame.device_time_us)
            arrivals.sequence.append(frame.sequence)
    return arrivals


def _stale(samples: dict[str, Times]) -> int:
    """Commands that were written although a newer state was known by then."""
    changes_ns, ours = np.sort(samples["change_ns"]), samples["stamps_ns"]
    following = np.searchsorted(changes_ns, ours[:, Stage.STATE], side="right")
    next_ns = np.append(changes_ns, np.iinfo(np.int64).max)[following]
    return int((next_ns < ours[:, Stage.WRITTEN]).sum())
