"""Times the engine's own loop, compiled step included, between a source and a port in memory: no system call.

It plays the default rule: every finger that comes down feels a click.
"""

import ctypes
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any

import numpy as np

from base.arrays import Array, Integers, Mask
from engine.effects.rules import DEFAULT_EFFECTS, Effects
from engine.loop.fast.fast_layout import NONE
from engine.loop.fast.fast_path import FastPath
from engine.loop.observer import Trace
from engine.table import Table
from engine.touch import open_digitizer
from engine.touch.sources import OnClock
from firmware_link.emulator.device_state import DeviceConfiguration
from tactable.bench.ends import LightDevice
from tactable.bench.inputs import MOST_COMMANDS_HZ, Stream
from tactable.bench.latency.stages import figures_of
from tactable.rig.emulate import configuration_of
from tactable.run.live_run import Live, LiveOptions

_MEMORY_BIT_RATE_HZ = 1_000_000_000
REPORTS_HZ = 2 * MOST_COMMANDS_HZ  # a tap and its lift in turn, as fast as clicks may follow each other
_PERIOD_NS = 1_000_000_000 // REPORTS_HZ
_PASSES_AN_ANSWER = 16
Times = Array


class _PacedClock:
    """The monotonic clock, which a wait sets forward at once."""

    def __init__(self) -> None:
        self._ahead_ns = 0
        self.waited_ns = 0  # real time of the last wait, where a pass of the loop ends

    def now_ns(self) -> int:
        return time.monotonic_ns() + self._ahead_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> None:  # noqa: ARG002
        self.waited_ns = time.monotonic_ns()
        self._ahead_ns += _PERIOD_NS


class _Memory(OnClock):
    """A source of one report a wait, and what answers its port at once; both note when they were called."""

    packet_head = 0

    def __init__(self, stream: Stream, count: int, configuration: DeviceConfiguration, clock: _PacedClock) -> None:
        self.name, self.descriptor = stream.name, stream.descriptor
        self.vendor_id, self.product_id = stream.vendor_id, stream.product_id
        # Of each report in hand: ns until the loop asks for more, and until something was written, 0 where nothing was;
        # whether the compiled step answered it.
        self.noted: list[list[int]] = []
        self._reports = list(islice(cycle(stream.reports), count))
        self.clock = clock
        self._device = LightDevice(configuration, clock.now_ns())
        self._written: list[bytes] = []
        self._asked = 0
        self._in_hand_ns = 0
        self._pass_of = 0

    @property
    def ended(self) -> bool:
        return self.report_index == len(self._reports) - 1

    def fileno(self) -> int:
        return -1

    def next_time_ns(self) -> None:
        """A report comes with each wait."""

    def read(self, now_ns: int) -> bytes | None:
        if len(self.noted) <= self.report_index:
            self.note(time.monotonic_ns() - self._in_hand_ns, 0)
        if self._pass_of == self.clock.waited_ns or self.ended:
            return None
        self._pass_of = self.clock.waited_ns
        self.report_index += 1
        self.report_time_ns = now_ns
        report = self._reports[self.report_index]
        self._in_hand_ns = time.monotonic_ns()
        return report

    def note(self, answer_ns: int, write_ns: int, *, is_fast: bool = False) -> None:
        self.noted.append([answer_ns, write_ns, is_fast])

    def write(self, data: bytes) -> int:
        if self.noted and not self.noted[-1][1]:
            self.noted[-1][1] = time.monotonic_ns() - self._in_hand_ns
        self._written.append(data)
        return len(data)

    def read_port(self) -> bytes:
        # Only sometimes: the emulated firmware would drive what is measured out of the caches each time.
        self._asked += 1
        if self.report_index >= 0 and self._asked % _PASSES_AN_ANSWER:
            return b""
        now_ns, data = self.clock.now_ns(), b"".join(self._written)
        self._written.clear()
        return self._device.receive(data, now_ns) + self._device.run_until(now_ns)

    packet_fileno = fileno

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:  # noqa: ARG002  # a PacketSource
        return packet


class _MemoryFastPath(FastPath):
    """The compiled step on a report in memory, from the call to its return."""

    _packets: _Memory

    def _run(self, until_ns: int) -> None:  # noqa: ARG002  # the clock is set forward instead
        fast, source, library = self._moment.fast, self._packets, self._library
        fast.packet_size = fast.frame_size = fast.written = 0
        fast.readable[:] = (1,) * len(fast.readable)
        source.clock.wait(None, (), ())
        now_ns = fast.read_ns = fast.written_ns = source.clock.now_ns()
        report = source.read(now_ns)
        if report is None:
            return
        fast.packet_size = len(report)
        fast.packet[: len(report)] = report
        library.fast_set_time(now_ns)
        before_ns = time.monotonic_ns()
        is_answered = fast.can_answer and library.fast_answer(self._moment.address)
        duration_ns = time.monotonic_ns() - before_ns
        library.fast_set_time(NONE)
        if is_answered:
            source.note(duration_ns, duration_ns, is_fast=True)
            fast.written = source.write(bytes(fast.frame[: fast.frame_size]))


class _MemoryPort:
    """The port's half."""

    def __init__(self, memory: _Memory) -> None:
        self._memory = memory
        self.fileno, self.write, self.read = memory.fileno, memory.write, memory.read_port


@dataclass(frozen=True)
class InProcess:
    """All reports of a stream (report,): ns until the answer, whether a command came, and the number of fingers.

    is_fast (report,): whether the compiled step answered.
    """

    stream: str
    simulated: bool
    answer_ns: Times
    has_command: Mask
    is_fast: Mask
    fingers: Integers

    def figures_json(self) -> dict[str, Any]:
        """Figures over the reports that bring a command, over all, and over the commands of one finger and of ten."""
        chosen = {
            "report_to_bytes": self.has_command,
            "report_to_answer": np.ones_like(self.has_command),
            "of_one_finger": self.has_command & (self.fingers <= 1),
            "of_ten_fingers": self.has_command & (self.fingers >= 10),
        }
        figures = {name: figures_of(self.answer_ns[where]) for name, where in chosen.items()}
        about = {"stream": self.stream, "simulated": self.simulated, "reports": len(self.answer_ns)}
        return about | {"by_fast_path": int(self.is_fast.sum())} | figures


def together(parts: Sequence[InProcess]) -> InProcess:
    """The reports of several streams as one."""
    columns = zip(*((part.answer_ns, part.has_command, part.is_fast, part.fingers) for part in parts), strict=True)
    return InProcess(
        f"all {len(parts)} recordings", any(part.simulated for part in parts), *map(np.concatenate, columns)
    )


def measure_in_process(
    table: Table, stream: Stream, count: int, library: ctypes.CDLL | None, effects: Effects = DEFAULT_EFFECTS
) -> InProcess:
    """Time `count` reports until the bytes of the command are ready, or until it is known that none is due.

    Without the `library` of the compiled step the loop answers every report.
    """
    clock = _PacedClock()
    memory = _Memory(stream, count, configuration_of(table.device), clock)
    options = LiveOptions(effects, reconnect=True, bit_rate_hz=_MEMORY_BIT_RATE_HZ, fast=library)
    trace = Trace()
    Live(table, memory, _MemoryPort(memory), clock, options, trace, fast_path=_MemoryFastPath).run()
    answer_ns, write_ns, is_fast = np.array(memory.noted, np.float64).reshape(-1, 3).T
    caused = [change.report_index for change in trace if change.drive_sequence is not None]
    has_command = np.isin(np.arange(len(write_ns)), [index for index in caused if index is not None]) & (write_ns > 0)
    return InProcess(
        stream.name,
        stream.simulated,
        np.where(has_command, write_ns, answer_ns),
        has_command,
        is_fast.astype(np.bool_),
        np.array(_fingers(stream, count), np.int64),
    )


def _fingers(stream: Stream, count: int) -> list[int]:
    """Number of contacts after each report (report,)."""
    digitizer = open_digitizer(stream.descriptor, stream.vendor_id, stream.product_id)
    counts, fingers = [], 0
    for number, report in enumerate(islice(cycle(stream.reports), count)):
        frame = digitizer.decode_report(report, number * _PERIOD_NS)
        fingers = fingers if frame is None else len(frame.contacts)
        counts.append(fingers)
    return counts
