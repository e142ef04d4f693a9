"""The schedule and its stalls: a report keeps the time at which it was due, and stands still with its layer only."""

import os
import socket
import time
from itertools import cycle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactable.bench.latency.load_generator import EchoReceiver, LoadGenerator, Schedule, Stall, StalledLayer
from tactable.bench.latency.sockets import SocketSource

pytestmark = pytest.mark.machine

PACKETS = [bytes([number]) * 20 for number in range(7)]


@given(st.integers(0, 10**10), st.integers(1, 10**8), st.integers(1, 10**8))
def test_a_stall_comes_and_goes_when_it_says(since_ns: int, duration_ns: int, pause_ns: int) -> None:
    stall = Stall(StalledLayer.LINK, duration_ns, duration_ns + pause_ns)
    change_ns = stall.next_change_ns(since_ns)
    assert since_ns < change_ns <= since_ns + max(duration_ns, pause_ns)
    assert stall.is_on(change_ns) != stall.is_on(change_ns - 1)
    assert stall.is_on(change_ns - 1) == stall.is_on(since_ns)


def test_every_report_goes_out_in_order_with_the_time_at_which_it_was_due() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    done, end = os.pipe()
    with ours, theirs:
        start_ns, count = time.monotonic_ns(), 500
        # Due at once: more than a socket takes without somebody who reads.
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        schedule = Schedule(cycle(PACKETS), 10_000.0, count, start_ns)
        source = SocketSource(theirs.fileno(), "bench", b"", (1, 2), count)
        reports, due_ns = list[bytes](), list[int]()

        def take() -> bool:
            while (report := source.read(0)) is not None:
                reports.append(report)
                due_ns.append(source.report_time_ns)
            return source.ended

        LoadGenerator(schedule, ours, None, None).run(done, take)
    os.close(done)
    os.close(end)
    assert reports == [PACKETS[number % 7] for number in range(count)]
    assert due_ns == [start_ns + number * 100_000 for number in range(count)]
    assert all(sent >= due for sent, due in zip(source.sent_ns, due_ns, strict=True))
    assert source.ended


def test_a_digitizer_that_stalls_sends_nothing_and_then_everything() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    done, end = os.pipe()
    with ours, theirs:
        start_ns, count = time.monotonic_ns(), 200
        schedule = Schedule(cycle(PACKETS), 1000.0, count, start_ns)
        stall = Stall(StalledLayer.DIGITIZER, 30_000_000, 100_000_000)
        source = SocketSource(theirs.fileno(), "bench", b"", (1, 2), count)

        def take() -> bool:
            while source.read(0) is not None:
                pass
            return source.ended

        LoadGenerator(schedule, ours, None, None, stall=stall).run(done, take)
    os.close(done)
    os.close(end)
    during = [
        number for number, sent in enumerate(source.sent_ns) if stall.is_on(sent - start_ns) and number < count - 40
    ]
    # What was due before, and is being sent when the stall begins, may still go.
    assert len(during) <= 3
    held_back = [source.sent_ns[number] - start_ns - number * 1_000_000 for number in range(72, 98)]
    assert min(held_back) > 0
    assert source.report_index == count - 1


@pytest.mark.parametrize(("awake_ns", "most_passes"), [(0, 10), (50_000_000, None)])
def test_the_receiver_of_answers_stays_awake_after_a_report(
    monkeypatch: pytest.MonkeyPatch, awake_ns: int, most_passes: int | None
) -> None:
    """A write then has nobody to wake up, whichever engine writes."""
    monkeypatch.setattr("tactable.bench.latency.load_generator.AWAKE_NS", awake_ns)
    passes = 0

    class Receiver(EchoReceiver):
        def advance(self, now_ns: int) -> bytes:
            nonlocal passes
            passes += 1
            return super().advance(now_ns)

    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    link, their_link = socket.socketpair()
    done, end = os.pipe()
    with ours, theirs, link, their_link:
        start_ns = time.monotonic_ns()
        LoadGenerator(Schedule(cycle(PACKETS), 1.0, 1, start_ns), ours, link, Receiver()).run(
            done, lambda: time.monotonic_ns() > start_ns + 100_000_000
        )
    os.close(done)
    os.close(end)
    assert passes > 20 if most_passes is None else passes <= most_passes
