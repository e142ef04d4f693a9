"""The engine under measurement, a child process: it runs one segment after another on the sockets it is given."""

import ctypes
import math
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from base.child import Parent
from base.plain import to_plain
from engine.effects.rules import DEFAULT_EFFECTS, Drives
from engine.loop.loop import SystemClock
from engine.loop.observer import CommandRecord, Fate, Stage, Trace
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from firmware_link.host.clock import OffsetBounds
from firmware_link.host.serial_port import DescriptorPort, SerialPort
from firmware_link.host.session import Port
from firmware_link.protocol.framing import FrameDecoder
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Status, decode_body
from tactable.bench.ends import SocketSource
from tactable.bench.inputs import place_of
from tactable.bench.latency.conditions import WITHOUT_FAST_PATH, ZONES, BackgroundLoad, Condition
from tactable.run.live_run import Live, LiveOptions, fast_library

NO_SEQUENCE = -1


@dataclass(frozen=True)
class Segment:
    """One uninterrupted stretch of measurement, as the engine's process is told of it."""

    descriptor: bytes
    numbers: tuple[int, int]  # vendor and product of the digitizer
    count: int  # reports to come
    condition: Condition
    processor: int
    samples: Path  # where the arrays go, .npz
    port: str | None  # a serial port; None: the second socket
    bit_rate_hz: int


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Open the table and say so; then run a segment for each line, saying when it is armed and when it is over."""
    library = fast_library()
    with Table.open(Path(arguments["table"])) as table:
        parent.say({"device": table.device.name})
        while (order := parent.read()) is not None:
            descriptors, parent.descriptors = parent.descriptors, []
            _run(table, order["segment"], descriptors, parent, library)


def _run(table: Table, segment: Segment, descriptors: list[int], parent: Parent, library: ctypes.CDLL | None) -> None:
    condition, plays_rows = segment.condition, segment.condition.engine == ZONES
    fast = None if condition.engine == WITHOUT_FAST_PATH else library
    with ExitStack() as stack:
        for descriptor in descriptors:
            stack.enter_context(socket.socket(fileno=descriptor))
        source = SocketSource(descriptors[0], segment.descriptor, segment.numbers, segment.count)
        port = _ListeningPort(
            DescriptorPort("the socket", descriptors[1])
            if segment.port is None
            else stack.enter_context(SerialPort(segment.port, segment.bit_rate_hz))
        )
        trace = Trace()
        effects = replace(DEFAULT_EFFECTS, drives=Drives.ZONES) if plays_rows else DEFAULT_EFFECTS
        options = LiveOptions(effects, False, True, segment.bit_rate_hz, condition.steps, segment.processor, fast)
        if condition.load is BackgroundLoad.THREAD:
            stack.enter_context(_busy_thread())
        live = Live(table, source, port, SystemClock(), options, trace)
        with live.armed():
            parent.say({"board": live.capabilities.board})
            live.loop.run()
        try:
            bounds = live.link.clock.offset_bounds(SystemClock().now_ns())
        except ValueError as error:
            lost = "the device was lost and not back when the touches ended"
            raise LinkError(f"{lost}: it, or this machine, is too slow for the rate") from error
        # A finger that lifts ends what is wanted, but its click ends by itself: the device holds silence already.
        changes = [change for change in trace if change.fate is not Fate.SAME]
        samples = _samples(live, source, changes)
        predicted = _predictions(None if plays_rows else table, changes, samples)
        np.savez(segment.samples, **samples, **predicted, **port.applied(bounds))
        parent.say(
            {
                "outcomes": to_plain(live.outcomes),
                "loop": to_plain(live.loop.counters),
                "fast_path": to_plain(live.fast_counters),
                "link": to_plain(live.link.counters),
                "digitizer": to_plain(live.digitizer.counters),
                "clock_bounds_ns": [bounds.lower_ns, bounds.upper_ns],
            }
        )


@contextmanager
def _busy_thread() -> Iterator[None]:
    """Run another Python thread of this process that never waits."""
    end = threading.Event()

    def burn() -> None:
        while not end.is_set():
            sum(range(100))

    thread = threading.Thread(target=burn, daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


class _ListeningPort:
    """A port that keeps what the device said on it."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._heard: list[bytes] = []

    def fileno(self) -> int:
        return self._port.fileno()

    def read(self) -> bytes:
        data = self._port.read()
        self._heard.append(data)
        return data

    def write(self, data: bytes) -> int:
        return self._port.write(data)

    def applied(self, bounds: OffsetBounds) -> dict[str, Any]:
        """The sequences that the device says it applied, and when, on the host's clock."""
        bodies = [body for body in FrameDecoder().receive(b"".join(self._heard)) if isinstance(body, bytes)]
        said = [message for _, message in map(decode_body, bodies) if isinstance(message, Status) and message.applied]
        times = {(status.applied_time_us, status.applied_sequence): None for status in said}
        return {
            "applied_ns": np.array([1_000 * time_us - round(bounds.middle_ns) for time_us, _ in times], np.int64),
            "applied_sequence": np.array([sequence for _, sequence in times], np.int64),
            "bounds_half_width_ns": np.int64(bounds.half_width_ns),
        }


def _samples(live: Live, source: SocketSource, changes: Sequence[CommandRecord]) -> dict[str, Any]:
    """Stamps of the commands with the sequence of each, times of all reports, and all changes with a command."""
    stamps_ns = live.timing.latency.rows_ns()
    sequence_of = {change.time_ns: change.drive_sequence for change in changes if change.drive_sequence is not None}
    sequences = [sequence_of.get(int(time_ns), NO_SEQUENCE) for time_ns in stamps_ns[:, Stage.STATE]]
    return {
        "stamps_ns": stamps_ns,
        "sequence": np.array(sequences, np.int64),
        "sent_ns": np.array(source.sent_ns[: source.report_index + 1], np.int64),
        "read_ns": np.array(source.read_ns[: source.report_index + 1], np.int64),
        "change_ns": np.array([change.time_ns for change in changes], np.int64),
        "change_report": np.array(
            [NO_SEQUENCE if change.report_index is None else change.report_index for change in changes], np.int64
        ),
        "change_place": np.array([place_of(change.placement) for change in changes], np.int64),
    }


def _predictions(table: Table | None, changes: Sequence[CommandRecord], samples: dict[str, Any]) -> dict[str, Any]:
    """Ns from the start of each click until the last felt finger feels it, as the table has it; NaN without a click."""
    placement_of = {change.time_ns: change.placement for change in changes}
    felt_ns = []
    for time_ns in samples["stamps_ns"][:, Stage.STATE].tolist():
        placement = placement_of.get(time_ns)
        click = None if placement is None or table is None else table.click_at(placement, DEFAULT_LEVEL_DB)
        after_s = None if click is None else click.exceeds_at_s()
        felt_ns.append(math.nan if after_s is None else 1e9 * after_s)
    return {"prediction_ns": np.array(felt_ns)}
