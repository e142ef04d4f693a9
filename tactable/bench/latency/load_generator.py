"""Open-loop load generator: sends reports when they are due, whatever the engine does, and serves the link's far end.

One thread does both. A report that is late keeps the time at which it was due, so a stall of 60 ms shows as sixty late
reports at 1000 a second and not as one. A layer can be made to stall, to see the report name it.

After each report the thread stays awake for AWAKE_NS and polls the link. A write to a socket whose reader sleeps has to
wake it up, which costs more than an engine does; whether the reader slept already depended on how much its far end had
to do, so the C echo paid for a wake-up that the engine did not. Awake, neither pays.
"""

import contextlib
import os
import signal
import socket
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from engine.loop.loop import Clock, SystemClock
from tactable.bench.ends import STAMPS, Arrivals, LightDevice

LEAD_NS = 20_000_000  # from the start of a schedule to its first report: the handshake is over, the engine waits
AWAKE_NS = 200_000  # after a report the load generator stays awake: five times what an engine takes to answer
_NS_PER_S = 1_000_000_000
_READ_SIZE = 65_536  # read until it is empty: bounds one call
_LONGEST_WAIT_NS = 20_000_000  # where nothing is due: `is_over` is asked 50 times a second
SYSTEM_CLOCK = SystemClock()


class EchoReceiver:
    """Notes when each answer of the C echo engine came."""

    def __init__(self) -> None:
        self.arrivals = Arrivals()

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Count answers by the only zero in each, which ends it."""
        for _ in range(data.count(0)):
            self.arrivals.time_ns.append(now_ns)
            self.arrivals.sequence.append(0)
        return b""

    def run_until(self, now_ns: int) -> bytes:  # noqa: ARG002  # as LightDevice
        """The echo engine gets no bytes."""
        return b""

    def next_deadline_ns(self) -> None:
        """Never."""


class StalledLayer(StrEnum):
    """Layer into which a stall is injected."""

    DIGITIZER = "digitizer"  # reports are held back, then all come at once
    HOST = "host"  # the engine's process is stopped
    LINK = "link"  # nothing takes bytes off the line


@dataclass(frozen=True)
class Stall:
    """A layer that stands still at the end of each period."""

    layer: StalledLayer
    duration_ns: int = 60_000_000
    period_ns: int = 250_000_000

    def is_on(self, since_start_ns: int) -> bool:
        """Whether the layer stands still at this time after the start."""
        return since_start_ns > 0 and since_start_ns % self.period_ns >= self.period_ns - self.duration_ns

    def next_change_ns(self, since_start_ns: int) -> int:
        """Time after the start at which `is_on` changes next."""
        phase_ns = max(0, since_start_ns) % self.period_ns
        on_ns = self.period_ns - self.duration_ns
        return max(0, since_start_ns) - phase_ns + (on_ns if phase_ns < on_ns else self.period_ns)


@dataclass
class Schedule:
    """`count` reports at `rate_hz` from `start_ns` on."""

    reports: Iterator[bytes]
    rate_hz: float
    count: int
    start_ns: int
    next: int = field(default=0, init=False)

    @classmethod
    def none(cls) -> "Schedule":
        """No reports: only the link is served."""
        return cls(iter(()), 1.0, 0, 0)

    def due_ns(self) -> int | None:
        """Time at which the next report is due, perhaps in the past; None after the last."""
        return None if self.next == self.count else self.time_of_ns(self.next)

    def time_of_ns(self, report: int) -> int:
        """Time at which a report is due, by its index."""
        return self.start_ns + round(report * _NS_PER_S / self.rate_hz)


class LoadGenerator:
    """Sends the reports of a schedule and serves the far end of the link until the engine is done.

    `engine_process_id` is for a stall of the host. What a full socket does not take stays due. After the last report
    the stream of reports ends, unless it `keeps_open`. All its times are those of `clock`.
    """

    def __init__(
        self,
        schedule: Schedule,
        touch: socket.socket,
        link: socket.socket | None,
        far_end: LightDevice | EchoReceiver | None,
        *,
        stall: Stall | None = None,
        engine_process_id: int = 0,
        keeps_open: bool = False,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._schedule, self._touch, self._link, self._far_end = schedule, touch, link, far_end
        self._stall, self._engine_process_id = stall, engine_process_id
        self._clock, self._now_ns = clock, clock.now_ns
        self._packet: bytes | None = None
        self._is_full = self._engine_is_stopped = False
        self._keeps_open = keeps_open
        self._awake_until_ns = 0
        touch.setblocking(False)
        if link is not None:
            link.setblocking(False)

    def run(self, done: int, is_over: Callable[[], bool] = lambda: False) -> None:
        """Run until the descriptor `done` can be read, or `is_over` says so."""
        try:
            while not is_over():
                readable = self._wait(done)
                if done in readable:
                    return
                now_ns = self._now_ns()
                self._follow_stall(now_ns)
                self._send_due(now_ns)
                if self._link is not None and self._far_end is not None:
                    self._serve_link(self._link, self._far_end, self._link.fileno() in readable)
        finally:
            self._resume_engine()

    def _wait(self, done: int) -> Container[int]:
        now_ns = self._now_ns()
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
        far_end_ns = None if self._far_end is None else self._far_end.next_deadline_ns()
        if far_end_ns is not None:
            due_ns.append(far_end_ns)
        now_ns = self._now_ns()
        until_ns = now_ns if now_ns < self._awake_until_ns else min(due_ns)
        found = self._clock.wait(until_ns, readable, [self._touch.fileno()] if self._is_full else [])
        self._is_full = False  # if it still is, the next write tells
        return () if found is None else found

    def _is_stalled(self, layer: StalledLayer, now_ns: int) -> bool:
        stall, schedule = self._stall, self._schedule
        if stall is None or stall.layer is not layer or schedule.next == schedule.count:
            return False
        return stall.is_on(now_ns - schedule.start_ns)

    def _follow_stall(self, now_ns: int) -> None:
        if not self._is_stalled(StalledLayer.HOST, now_ns):
            self._resume_engine()
        elif not self._engine_is_stopped:
            os.kill(self._engine_process_id, signal.SIGSTOP)
            self._engine_is_stopped = True

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
                os.write(self._touch.fileno(), STAMPS.pack(due_ns, self._now_ns()) + self._packet)
            except (BlockingIOError, BrokenPipeError, ConnectionResetError):
                self._is_full = True  # or the engine has ended: it says why
                return
            self._packet = None
            self._awake_until_ns = self._now_ns() + AWAKE_NS if self._link is not None else 0
            schedule.next += 1
            due_ns = schedule.due_ns()
        if due_ns is None and not self._keeps_open:
            self._keeps_open = True
            with contextlib.suppress(OSError):  # the engine has ended
                self._touch.shutdown(socket.SHUT_WR)

    def _serve_link(self, link: socket.socket, far_end: LightDevice | EchoReceiver, is_readable: bool) -> None:
        data = b""
        try:
            if is_readable:
                data = os.read(link.fileno(), _READ_SIZE)
                self._link = link if data else None
            now_ns = self._now_ns()
            answer = (far_end.receive(data, now_ns) if data else b"") + far_end.run_until(now_ns)
            if answer:
                os.write(link.fileno(), answer)
        except OSError:  # full, as a wire that loses bytes, or the engine has ended
            return
