"""Measures one segment of a condition: the stamps of its commands, and whether every report came, in order."""

import contextlib
import os
import socket
import subprocess
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from base.arrays import Integers
from base.c_library import find_compiler
from base.child import Child
from engine.device import Device
from engine.loop.realtime import PRIORITY, Outcome, Step, real_time
from engine.table import Table
from firmware_link.emulator.emulator_process import run_emulator
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Play
from tactable.bench.ends import Arrivals, LightDevice
from tactable.bench.inputs import Stream, expected_clicks
from tactable.bench.latency.conditions import ECHO, Condition, Transport
from tactable.bench.latency.load_generator import LEAD_NS, EchoReceiver, LoadGenerator, Schedule, Stall
from tactable.bench.latency.stages import Stamps
from tactable.bench.latency.stamps import (
    Times,
    arrivals_at,
    count_stale,
    stamps_of_commands,
    stamps_of_echoes,
    stamps_of_replaced,
)
from tactable.bench.latency.timed_engine import Segment
from tactable.rig.emulate import configuration_of

_LINK_BUFFER_BYTES = 2_048  # small, so that a line that stands still is noticed: a real one has one frame in flight
_TOUCH_BUFFER_BYTES = 1 << 20  # reports of a stalled engine must wait, not block the load generator, whose times count


@dataclass
class Measured:
    """One segment: stamps of its commands, and what became of all reports."""

    stamps: Stamps
    due_ns: Times
    facts: dict[str, Any] = field(default_factory=dict)
    outcomes: tuple[Outcome, ...] = ()


class Bench:
    """Runs segments one after another in a `with` block, which keeps the engine's process alive.

    `streams` has the touches for each rate; without `echo`, a program, the C echo engine cannot be measured.
    """

    def __init__(
        self, table: Table, streams: Mapping[int, Stream], folder: Path, transport: Transport, echo: Path | None
    ) -> None:
        self._streams, self._folder, self._transport, self._echo = streams, folder, transport, echo
        self._device: Device = table.device
        self._table_path = table.path
        count = table.clicks.weights.shape[1]
        self._command_size = len(encode_message(Play(0, 0, 1, 0, count, (0,) * count), 0))
        """Bytes of the longest PLAY on the line."""
        allowed = sorted(os.sched_getaffinity(0))
        self._own_processor, self._engine_processor = allowed[0], allowed[-1]
        self._stack = ExitStack()
        self._exchange = build_program("exchange", folder)
        self.generator_outcomes: tuple[Outcome, ...] = ()  # the real-time steps of the load generator
        self.exchanges_ns: list[int] = []  # what `measure_exchange` found, in order

    def __enter__(self) -> "Bench":
        arguments = {"table": str(self._table_path)}
        self._engine = self._stack.enter_context(
            Child("tactable.bench.latency.timed_engine", arguments, name="the engine under measurement")
        )
        self._engine.read()
        # What measures must not be what waits; the sleep of processors is part of what is measured.
        steps = (Step.PRIORITY, Step.MEMORY, Step.AFFINITY, Step.COLLECTOR)
        self.generator_outcomes = self._stack.enter_context(real_time(steps, processor=self._own_processor))
        return self

    def __exit__(self, *unused: object) -> None:
        self._stack.close()

    def measure_exchange(self) -> None:
        """Measure how far apart the processors of load generator and engine are, unless there is no C compiler."""
        found_ns = exchange_ns(self._exchange, self._own_processor, self._engine_processor)
        if found_ns is not None:
            self.exchanges_ns.append(found_ns)

    def measure(self, condition: Condition, seconds: float, stall: Stall | None = None) -> Measured:
        """Measure one segment. Raises LinkError or ChildError where the engine, the port or its device fails."""
        stream = self._streams[condition.rate_hz]
        count = max(1, round(condition.rate_hz * seconds))
        if condition.engine == ECHO:
            return self._measure_echo(condition, stream, count)
        return self._measure_engine(condition, stream, count, stall)

    def _measure_engine(self, condition: Condition, stream: Stream, count: int, stall: Stall | None) -> Measured:
        path, engine = self._folder / "segment.npz", self._engine
        with ExitStack() as stack:
            touch, their_touch = _touch_pair(stack)
            link, their_link, far_end, emulator = None, None, None, None
            if self._transport.name == "pty":
                emulator = stack.enter_context(run_emulator(configuration_of(self._device)))
            if self._transport.is_sockets:
                link, their_link = _link_pair(stack)
                far_end = LightDevice(configuration_of(self._device), time.monotonic_ns())
            numbers, bit_rate_hz = (stream.vendor_id, stream.product_id), self._transport.bit_rate_hz
            port = emulator.port if emulator else None if self._transport.is_sockets else self._transport.name
            segment = Segment(
                stream.descriptor, numbers, count, condition, self._engine_processor, path, port, bit_rate_hz
            )
            theirs = [each for each in (their_touch, their_link) if each is not None]
            engine.write({"segment": segment}, [each.fileno() for each in theirs])
            _close(theirs)
            # The engine greets and arms the device, whose far end must be served meanwhile.
            LoadGenerator(Schedule.none(), touch, link, far_end, keeps_open=True).run(engine.fileno())
            armed = engine.read()
            schedule = Schedule(cycle(stream.reports), condition.rate_hz, count, time.monotonic_ns() + LEAD_NS)
            LoadGenerator(schedule, touch, link, far_end, stall=stall, engine_process_id=engine.process_id).run(
                engine.fileno()
            )
            answer = engine.read()
            arrivals = far_end.arrivals if far_end else arrivals_at(emulator) if emulator else Arrivals()
        with np.load(path) as arrays:
            samples = {name: arrays[name] for name in arrays.files}
        stamps, due_ns = stamps_of_commands(samples, arrivals, schedule)
        if stream.reports_per_command is not None:
            replaced, replaced_due_ns = stamps_of_replaced(samples, schedule)
            stamps, due_ns = np.concatenate([stamps, replaced]), np.concatenate([due_ns, replaced_due_ns])
        outcomes = tuple(Outcome(Step(o["step"]), o["finding"], o["remedy"]) for o in answer["outcomes"])
        facts = self._facts(answer, samples, schedule, stream) | {"board": armed["board"]}
        return Measured(stamps, due_ns, facts, outcomes)

    def _facts(
        self, answer: dict[str, Any], samples: dict[str, Times], schedule: Schedule, stream: Stream
    ) -> dict[str, Any]:
        by_reports = samples["change_report"] >= 0
        clicks = by_reports & (samples["change_place"] >= 0)
        reports, places = (samples[name][clicks].tolist() for name in ("change_report", "change_place"))
        expected = expected_clicks(stream, schedule.rate_hz, schedule.count, self._device)
        expired = answer["digitizer"]["expired_frames"]
        lower_ns, upper_ns = answer["clock_bounds_ns"]
        return {
            "reports_sent": schedule.next,
            "reports_lost": schedule.next - answer["loop"]["reports"],
            "commands": answer["loop"]["commands"],
            "answered_by_fast_path": answer["fast_path"]["answered"],
            "mispredicted": answer["fast_path"]["mispredicted"],
            "sessions_lost": answer["loop"]["reconnects"],
            "replaced_unsent": answer["link"]["coalesced"],
            "stale_sent": count_stale(samples),
            "order_kept": None if expired else [*zip(reports, places, strict=True)] == expected,
            "released_by_watchdog": expired,
            "clock_bounds_us": (upper_ns - lower_ns) / 1e3,
        }

    def _measure_echo(self, condition: Condition, stream: Stream, count: int) -> Measured:
        assert self._echo is not None  # the plan has no echo where there is none
        path, every = self._folder / "echo.bin", stream.reports_per_command or 1
        with ExitStack() as stack:
            touch, their_touch = _touch_pair(stack)
            link, their_link = _link_pair(stack)
            # The other steps are the C program's own.
            outcomes = stack.enter_context(real_time([s for s in condition.steps if s is Step.DMA_LATENCY]))
            descriptors = (their_touch.fileno(), their_link.fileno())
            size, processor = self._command_size, self._engine_processor
            process = start_echo_engine(self._echo, *descriptors, every, size, path, condition.steps, processor)
            ended = stack.enter_context(_until_ended(process))
            _close([their_touch, their_link])
            receiver = EchoReceiver()
            LoadGenerator(Schedule.none(), touch, link, receiver, keeps_open=True).run(
                ended, lambda: len(receiver.arrivals.time_ns) > 0
            )
            schedule = Schedule(cycle(stream.reports), condition.rate_hz, count, time.monotonic_ns() + LEAD_NS)
            LoadGenerator(schedule, touch, link, receiver).run(ended)
            status = process.wait()
        if status != 0:
            raise LinkError(f"the C echo engine ended with exit status {status}: leave it out with --no-echo")
        samples = read_echo_samples(path)
        # Its first answer said that it was ready.
        stamps = stamps_of_echoes(samples, np.array(receiver.arrivals.time_ns[1:], np.int64))
        facts = {"reports_sent": schedule.next, "commands": len(samples)}
        return Measured(stamps, samples[:, 0].copy(), facts, outcomes)


def build_program(name: str, folder: Path) -> Path | None:
    """Compile the C file `name` beside this module into `folder`; None where no compiler is there or none succeeds."""
    compiler, program = find_compiler(), folder / name
    if compiler is None:
        return None
    command = [compiler, "-O2", "-std=c11", "-o", str(program), str(Path(__file__).with_name(f"{name}.c"))]
    return program if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None


def exchange_ns(program: Path | None, first: int, second: int) -> int | None:
    """How long a cache line takes from one processor to another and back, ns, by the program `exchange`.

    None without the program, for one processor alone, and where it may not run on both.
    """
    if program is None or first == second:
        return None
    done = subprocess.run([str(program), str(first), str(second)], capture_output=True, text=True, check=False)
    return int(done.stdout) if done.returncode == 0 else None


def start_echo_engine(
    program: Path, touch: int, link: int, every: int, size: int, samples: Path, steps: Collection[Step], processor: int
) -> "subprocess.Popen[bytes]":
    """Start the C echo engine on two descriptors, with the real-time steps that a C program can take.

    Each of its answers has `size` bytes.
    """
    priority = PRIORITY if Step.PRIORITY in steps else 0
    chosen = processor if Step.AFFINITY in steps else -1
    numbers = (touch, link, every, size, samples, priority, chosen, int(Step.MEMORY in steps))
    return subprocess.Popen([str(program), *map(str, numbers)], pass_fds=(touch, link))


def read_echo_samples(path: Path) -> Integers:
    """Shape (answer, 4): when each was due, sent, read and written, ns."""
    return np.fromfile(path, np.int64).reshape(-1, 4)


def _touch_pair(stack: ExitStack) -> tuple[socket.socket, socket.socket]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _TOUCH_BUFFER_BYTES)
    return stack.enter_context(ours), stack.enter_context(theirs)


def _link_pair(stack: ExitStack) -> tuple[socket.socket, socket.socket]:
    ours, theirs = socket.socketpair()
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LINK_BUFFER_BYTES)
    return stack.enter_context(ours), stack.enter_context(theirs)


def _close(handed_over: list[socket.socket]) -> None:
    """Close this process's copies, so that the end of the other process shows."""
    for each in handed_over:
        each.close()


@contextlib.contextmanager
def _until_ended(process: "subprocess.Popen[bytes]") -> Iterator[int]:
    """A descriptor that can be read once the process has ended; it is killed at the end of the block."""
    descriptor = os.pidfd_open(process.pid)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
        if process.poll() is None:
            process.kill()
        process.wait()
