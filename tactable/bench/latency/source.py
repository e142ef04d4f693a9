"""A schedule to reports that go out when they are due, whatever the engine does with them, and to what comes back."""

import contextlib
import os
import select
import signal
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from tactable.bench.latency.sockets import STAMPS
from tactable.bench.light_device import Arrivals

_NS_PER_S = 1_000_000_000
_READ_SIZE = 65_536
_LONGEST_WAIT_NS = 20_000_000
# The engine is done with the handshake and waits.
LEAD_NS = 20_000_000


class Device(Protocol):
    """The other end of the link: `LightDevice`, or what only notes when an echo came."""

    arrivals: Arrivals

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes in; what to answer."""

    def advance(self, now_ns: int) -> bytes:
        """What it says by itself by now."""

    def next_deadline_ns(self) -> int | None:
        """When it has something to say."""


class Echoed:
    """Notes when each answer of the C echo engine came."""

    def __init__(self) -> None:
        self.arrivals = Arrivals()

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """An answer ends with the only zero in it."""
        for _ in range(data.count(0)):
            self.arrivals.time_ns.append(now_ns)
            self.arrivals.sequence.append(0)
        return b""

    def advance(self, now_ns: int) -> bytes:  # noqa: ARG002  # a Device
        """It says nothing by itself."""
        return b""

    def next_deadline_ns(self) -> None:
        """Never."""


class StalledLayer(StrEnum):
    """Where a stall is injected."""

    DIGITIZER = "digitizer"
    """Reports are held back, then all come at once."""
    HOST = "host"
    """The engine's process is stopped."""
    LINK = "link"
    """Nothing takes bytes off the line."""


@dataclass(frozen=True)
class Stall:
    """A layer that stands still for a while, again and again."""

    layer: StalledLayer
    duration_ns: int = 60_000_000
    period_ns: int = 250_000_000

    def is_on(self, since_start_ns: int) -> bool:
        """Whether it stands still: at the end of each period."""
        return since_start_ns > 0 and since_start_ns % self.period_ns >= self.period_ns - self.duration_ns

    def next_change_ns(self, since_start_ns: int) -> int:
        """When that changes."""
        phase_ns = max(0, since_start_ns) % self.period_ns
        on_ns = self.period_ns - self.duration_ns
        return max(0, since_start_ns) - phase_ns + (on_ns if phase_ns < on_ns else self.period_ns)


@dataclass
class Schedule:
    """`count` reports at `rate_hz` from `start_ns` on; each has its time, and a late one keeps it."""

    reports: Iterator[bytes]
    rate_hz: float
    count: int
    start_ns: int
    next: int = field(default=0, init=False)

    def due_ns(self) -> int | None:
        """When the next one is due, perhaps in the past; None after the last."""
        return None if self.next == self.count else self.time_of_ns(self.next)

    def time_of_ns(self, report: int) -> int:
        """When a report is due, by its index."""
        return self.start_ns + round(report * _NS_PER_S / self.rate_hz)


class Apparatus:
    """One thread that sends reports by a schedule and is the other end of the link, until the engine is done.

    `engine_process_id` is for a stall of the host. What a full socket does not take stays due. After the last report
    the source ends, unless it `keeps_open`.
    """

    def __init__(
        self,
        schedule: Schedule,
        touch: socket.socket,
        link: socket.socket | None,
        device: Device | None,
        *,
        stall: Stall | None = None,
        engine_process_id: int = 0,
        keeps_open: bool = False,
    ) -> None:
        self._schedule, self._touch, self._link, self._device = schedule, touch, link, device
        self._stall, self._engine_process_id = stall, engine_process_id
        self._packet: bytes | None = None
        self._is_full = self._engine_is_stopped = False
        self._keeps_open = keeps_open
        touch.setblocking(False)
        if link is not None:
            link.setblocking(False)

    def run(self, done: int, is_over: Callable[[], bool] = lambda: False) -> None:
        """Until the descriptor `done` can be read, or `is_over` says so."""
        try:
            while not is_over():
                readable = self._wait(done)
                if done in readable:
                    return
                now_ns = time.monotonic_ns()
                self._follow_stall(now_ns)
                self._send_due(now_ns)
                if self._link is not None and self._device is not None:
                    self._serve_link(self._link, self._device, self._link.fileno() in readable)
        finally:
            self._resume_engine()

    def _wait(self, done: int) -> list[int]:
        now_ns = time.monotonic_ns()
        due_ns = [now_ns + _LONGEST_WAIT_NS]
        readable = [done]
        if self._link is not None and not self._is_stalled(StalledLayer.LINK, now_ns):
            readable.append(self._link.fileno())
        if self._stall is not None:
            start_ns = self._schedule.start_ns
            due_ns.append(start_ns + self._stall.next_change_ns(now_ns - start_ns))
        report_ns = self._schedule.due_ns()
        if report_ns is not None and not self._is_full and not self._is_stalled(StalledLayer.DIGITIZER, now_ns):
            due_ns.append(report_ns)
        device_ns = None if self._device is None else self._device.next_deadline_ns()
        if device_ns is not None:
            due_ns.append(device_ns)
        timeout_s = max(0, min(due_ns) - time.monotonic_ns()) / _NS_PER_S
        ready, writable, _ = select.select(readable, [self._touch] if self._is_full else [], [], timeout_s)
        self._is_full = self._is_full and not writable
        return ready

    def _is_stalled(self, layer: StalledLayer, now_ns: int) -> bool:
        stall = self._stall
        is_running = self._schedule.next < self._schedule.count
        return (
            stall is not None and is_running and stall.layer is layer and stall.is_on(now_ns - self._schedule.start_ns)
        )

    def _follow_stall(self, now_ns: int) -> None:
        if self._is_stalled(StalledLayer.HOST, now_ns):
            if not self._engine_is_stopped:
                os.kill(self._engine_process_id, signal.SIGSTOP)
                self._engine_is_stopped = True
        else:
            self._resume_engine()

    def _resume_engine(self) -> None:
        if self._engine_is_stopped:
            os.kill(self._engine_process_id, signal.SIGCONT)
            self._engine_is_stopped = False

    def _send_due(self, now_ns: int) -> None:
        schedule = self._schedule
        if self._is_full or self._is_stalled(StalledLayer.DIGITIZER, now_ns):
            return
        due_ns = schedule.due_ns()
        while due_ns is not None and due_ns <= now_ns:
            if self._packet is None:
                self._packet = next(schedule.reports)
            try:
                os.write(self._touch.fileno(), STAMPS.pack(due_ns, time.monotonic_ns()) + self._packet)
            except BlockingIOError:
                self._is_full = True
                return
            except (BrokenPipeError, ConnectionResetError):  # the engine has ended; it says why
                self._is_full = True
                return
            self._packet = None
            schedule.next += 1
            due_ns = schedule.due_ns()
        if due_ns is None and not self._keeps_open:
            self._keeps_open = True
            with contextlib.suppress(OSError):  # the engine has ended
                self._touch.shutdown(socket.SHUT_WR)

    def _serve_link(self, link: socket.socket, device: Device, is_readable: bool) -> None:
        data = b""
        try:
            if is_readable:
                data = os.read(link.fileno(), _READ_SIZE)
                self._link = link if data else None
            now_ns = time.monotonic_ns()
            answer = (device.receive(data, now_ns) if data else b"") + device.advance(now_ns)
            if answer:
                os.write(link.fileno(), answer)
        except OSError:  # full, as a wire that loses bytes, or the engine has ended
            return
