"""Reports to bytes inside the process: the engine's own loop between a source and a port that are memory."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.digitizer import open_digitizer
from engine.renderer import WhenNotAchieved
from engine.table import Table
from tactable.latency_device import LightDevice
from tactable.latency_stages import figures_of
from tactable.latency_stream import HELD, Stream
from tactable.live import Live, LiveOptions

_MEMORY_BIT_RATE_HZ = 1_000_000_000
# A lease of 40 ms numbers a command each 0.3 ms: reports that came faster would wait for that.
_PERIOD_NS = 1_000_000
_PASSES_AN_ANSWER = 16
Times = NDArray[np.float64]


class _PacedClock:
    """The monotonic clock, set forward at each wait instead of waiting."""

    def __init__(self) -> None:
        self._ahead_ns = 0
        self.waited_ns = 0
        """Unchanged clock time of the last wait: where a pass ends."""

    def now_ns(self) -> int:
        return time.monotonic_ns() + self._ahead_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> None:  # noqa: ARG002
        self.waited_ns = time.monotonic_ns()
        self._ahead_ns += _PERIOD_NS


class _Memory:
    """A source of one report a wait, and a port whose other end answers at once; both note when they were called."""

    def __init__(self, stream: Stream, count: int, number_of_actuators: int, clock: _PacedClock) -> None:
        self.name, self.descriptor = stream.name, stream.descriptor
        self.vendor_id, self.product_id = stream.vendor_id, stream.product_id
        self.report_index = -1
        self.report_time_ns = 0
        self.answer_ns: list[int] = []
        """From each report in hand until the loop asks for more, or to the bytes of its command where it has one."""
        self.has_command: list[bool] = []
        self._reports = list(islice(stream.packets(), count))
        self._clock = clock
        self._device = LightDevice(number_of_actuators, clock.now_ns())
        self._written: list[bytes] = []
        self._asked = 0
        self._in_hand_ns = 0
        self._is_taken = True
        self._is_asked_again = True
        self._pass_of = 0

    @property
    def ended(self) -> bool:
        return self.report_index == len(self._reports) - 1

    def fileno(self) -> int:
        return -1

    def next_time_ns(self) -> None:
        """A report comes with each wait."""

    def read_report(self, now_ns: int) -> bytes | None:
        if not self._is_asked_again:
            self.answer_ns.append(time.monotonic_ns() - self._in_hand_ns)
            self.has_command.append(False)
            self._is_asked_again = True
        if self._pass_of == self._clock.waited_ns or self.ended:
            return None
        self._pass_of = self._clock.waited_ns
        self.report_index += 1
        self.report_time_ns = now_ns
        self._is_asked_again = self._is_taken = False
        report = self._reports[self.report_index]
        self._in_hand_ns = time.monotonic_ns()
        return report

    def source_time_ns(self, now_ns: int) -> int:
        return now_ns

    def clock_time_ns(self, source_time_ns: int) -> int:
        return source_time_ns

    def write(self, data: bytes) -> int:
        if not self._is_taken:
            self.answer_ns[-1] = time.monotonic_ns() - self._in_hand_ns
            self.has_command[-1] = self._is_taken = True
        self._written.append(data)
        return len(data)

    def read_port(self) -> bytes:
        # Now and then: the emulated firmware would take the caches from what is measured each time.
        self._asked += 1
        if self.report_index >= 0 and self._asked % _PASSES_AN_ANSWER:
            return b""
        now_ns, data = self._clock.now_ns(), b"".join(self._written)
        self._written.clear()
        return self._device.receive(data, now_ns) + self._device.advance(now_ns)


class _MemorySource(_Memory):
    """The source's half."""

    def read(self, now_ns: int) -> bytes | None:
        return self.read_report(now_ns)


class _MemoryPort:
    """The port's half."""

    def __init__(self, memory: _Memory) -> None:
        self._memory = memory
        self.fileno, self.write, self.read = memory.fileno, memory.write, memory.read_port


@dataclass(frozen=True)
class InProcess:
    """Every report of a stream: ns until its answer, whether that was a command, and how many fingers it told of."""

    stream: str
    simulated: bool
    answer_ns: Times
    has_command: NDArray[np.bool_]
    fingers: NDArray[np.int64]

    def figures_json(self) -> dict[str, Any]:
        """Figures over the reports that bring a command, over all, and over those of one and of ten fingers or more."""
        chosen = {
            "report_to_bytes": self.has_command,
            "report_to_answer": np.ones_like(self.has_command),
            "of_one_finger": self.fingers == 1,
            "of_ten_fingers": self.fingers >= 10,
        }
        found = {name: figures_of(self.answer_ns[where]) for name, where in chosen.items()}
        told = {name: None if figures is None else asdict(figures) for name, figures in found.items()}
        return {"stream": self.stream, "simulated": self.simulated, "reports": len(self.answer_ns)} | told


def together(parts: Sequence[InProcess]) -> InProcess:
    """All reports of several streams."""
    return InProcess(
        f"all {len(parts)} recordings",
        any(part.simulated for part in parts),
        np.concatenate([part.answer_ns for part in parts]),
        np.concatenate([part.has_command for part in parts]),
        np.concatenate([part.fingers for part in parts]),
    )


def measure_in_process(table: Table, stream: Stream, count: int) -> InProcess:
    """The answers to `count` reports: the bytes of a command are ready, or it is known that there is none."""
    clock = _PacedClock()
    memory = _MemorySource(stream, count, len(table.device.actuators), clock)
    options = LiveOptions(HELD, WhenNotAchieved.GO_ON, reconnect=True, bit_rate_hz=_MEMORY_BIT_RATE_HZ)
    Live(table, memory, _MemoryPort(memory), clock, options).run()
    return InProcess(
        stream.name,
        stream.simulated,
        np.array(memory.answer_ns, np.float64),
        np.array(memory.has_command, np.bool_),
        np.array(_fingers(stream, count), np.int64),
    )


def _fingers(stream: Stream, count: int) -> list[int]:
    """How many contacts there are after each report."""
    digitizer = open_digitizer(stream.descriptor, stream.vendor_id, stream.product_id)
    counts, fingers = [], 0
    for number, report in enumerate(islice(stream.packets(), count)):
        frame = digitizer.decode_report(report, number * _PERIOD_NS)
        fingers = fingers if frame is None else len(frame.contacts)
        counts.append(fingers)
    return counts
