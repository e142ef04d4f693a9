"""Open-loop load generator: sends reports when they are due, whatever the engine does, and serves the link's far end.

One thread does both. A report that is late keeps the time at which it was due, so a stall of 60 ms shows as sixty late
reports at 1000 a second and not as one.

After each report the thread stays awake for AWAKE_NS and polls the link. A write to a socket whose reader sleeps has to
wake it up, which costs more than an engine does; whether the reader slept already depended on how much its far end had
to do, so the C echo paid for a wake-up that the engine did not. Awake, neither pays.
"""

import contextlib
import os
import socket
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field

from engine.loop.loop import Clock, SystemClock
from tactable.bench.latency.sockets import STAMPS
from tactable.bench.light_device import Arrivals, LightDevice

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

    What a full socket does not take stays due. After the last report
    the stream of reports ends, unless it `keeps_open`. All its times are those of `clock`.
    """

    def __init__(
        self,
        schedule: Schedule,
        touch: socket.socket,
        link: socket.socket | None,
        far_end: LightDevice | EchoReceiver | None,
        *,
        keeps_open: bool = False,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._schedule, self._touch, self._link, self._far_end = schedule, touch, link, far_end
        self._clock, self._now_ns = clock, clock.now_ns
        self._packet: bytes | None = None
        self._is_full = False
        self._keeps_open = keeps_open
        self._awake_until_ns = 0
        touch.setblocking(False)
        if link is not None:
            link.setblocking(False)

    def run(self, done: int, is_over: Callable[[], bool] = lambda: False) -> None:
        """Run until the descriptor `done` can be read, or `is_over` says so."""
        while not is_over():
            readable = self._wait(done)
            if done in readable:
                return
            self._send_due(self._now_ns())
            if self._link is not None and self._far_end is not None:
                self._serve_link(self._link, self._far_end, self._link.fileno() in readable)

    def _wait(self, done: int) -> Container[int]:
        now_ns = self._now_ns()
        due_ns = [now_ns + _LONGEST_WAIT_NS]
        readable = [done]
        if self._link is not None:
            readable.append(self._link.fileno())
        report_ns = self._schedule.due_ns()
        if report_ns is not None and not self._is_full:
            due_ns.append(report_ns)
        far_end_ns = None if self._far_end is None else self._far_end.next_deadline_ns()
        if far_end_ns is not None:
            due_ns.append(far_end_ns)
        now_ns = self._now_ns()
        until_ns = now_ns if now_ns < self._awake_until_ns else min(due_ns)
        found = self._clock.wait(until_ns, readable, [self._touch.fileno()] if self._is_full else [])
        self._is_full = False  # if it still is, the next write tells
        return () if found is None else found

    def _send_due(self, now_ns: int) -> None:
        schedule = self._schedule
        if self._is_full:
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
