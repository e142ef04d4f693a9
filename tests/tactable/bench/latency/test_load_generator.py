"""The schedule and its stalls: a report keeps the time at which it was due, and stands still with its layer only."""

import contextlib
import socket
from itertools import cycle

import pytest

from tactable.bench.ends import SocketSource
from tactable.bench.latency.load_generator import EchoReceiver, LoadGenerator, Schedule, Stall, StalledLayer
from tests.tools.virtual import MS, VirtualClock

PACKETS = [bytes([number]) * 20 for number in range(7)]


class Run:
    """A load generator, the engine's end of the touches, and what is read there, on one virtual clock."""

    def __init__(
        self,
        rate_hz: float,
        count: int,
        *,
        stall: Stall | None = None,
        late_ns: int = 0,
        far: EchoReceiver | None = None,
    ) -> None:
        clock, self.reports, self.due_ns = VirtualClock(), list[bytes](), list[int]()
        self.start_ns = clock.time_ns - late_ns
        with contextlib.ExitStack() as stack:
            pairs = (socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET), socket.socketpair(), socket.socketpair())
            (ours, theirs), (link, _), (done, _) = [[stack.enter_context(end) for end in pair] for pair in pairs]
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            self.source = SocketSource(theirs.fileno(), b"", (1, 2), count, clock.now_ns)
            schedule = Schedule(cycle(PACKETS), rate_hz, count, self.start_ns)
            generator = LoadGenerator(schedule, ours, None if far is None else link, far, stall=stall, clock=clock)
            generator.run(done.fileno(), lambda: self.take_reports() and clock.time_ns > self.start_ns + 100 * MS)

    def take_reports(self) -> bool:
        while (report := self.source.read(0)) is not None:
            self.reports.append(report)
            self.due_ns.append(self.source.report_time_ns)
        return self.source.ended


def test_every_report_goes_out_in_order_with_the_time_at_which_it_was_due() -> None:
    # Due at once: more than the socket takes without somebody who reads.
    run = Run(10_000.0, 500, late_ns=1_000 * MS)
    assert run.reports == [PACKETS[number % 7] for number in range(500)]
    assert run.due_ns == [run.start_ns + number * 100_000 for number in range(500)]
    assert all(sent >= due for sent, due in zip(run.source.sent_ns, run.due_ns, strict=True))


def test_a_digitizer_that_stalls_sends_nothing_and_then_everything() -> None:
    stall = Stall(StalledLayer.DIGITIZER, 30 * MS, 100 * MS)
    run = Run(1000.0, 200, stall=stall)
    late_ms = [(sent - due) / MS for sent, due in zip(run.source.sent_ns, run.due_ns, strict=True)]
    expected_ms = [100 - number % 100 if stall.is_on(number * MS) else 0 for number in range(200)]
    assert late_ms == pytest.approx(expected_ms, abs=0.1)
    assert max(expected_ms) == 30


@pytest.mark.parametrize(("awake_ns", "least", "most"), [(0, 1, 10), (50 * MS, 20, 10**6)])
def test_the_receiver_of_answers_stays_awake_after_a_report(
    monkeypatch: pytest.MonkeyPatch, awake_ns: int, least: int, most: int
) -> None:
    """A write then has nobody to wake up, whichever engine writes."""
    monkeypatch.setattr("tactable.bench.latency.load_generator.AWAKE_NS", awake_ns)
    passes = 0

    class Receiver(EchoReceiver):
        def run_until(self, now_ns: int) -> bytes:
            nonlocal passes
            passes += 1
            return super().run_until(now_ns)

    Run(1.0, 1, far=Receiver())
    assert least <= passes <= most
