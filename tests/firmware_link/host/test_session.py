"""Laws of a session and its port: bytes arrive whole and in order, and a lost port is opened again after pauses."""

import itertools
import random

import pytest

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration
from firmware_link.host.serial_port import (
    FIRST_PAUSE_NS,
    LONGEST_PAUSE_NS,
    PortDescription,
    ReopeningPort,
    stable_name_of,
)
from firmware_link.host.session import Session
from firmware_link.protocol.framing import FrameDecoder
from firmware_link.protocol.link_errors import LinkLostError
from firmware_link.protocol.messages import HelloRequest, decode_body
from tests.tools.virtual import MS, VirtualClock, VirtualLine


class SlowPort:
    """Takes at most `most` bytes at a time, and has nothing to read; gone, it raises."""

    def __init__(self, most: int = 1_000) -> None:
        self.most = most
        self.written = b""
        self.is_gone = False

    def fileno(self) -> int:
        return -1

    def read(self) -> bytes:
        return b""

    def write(self, data: bytes) -> int:
        if self.is_gone:
            raise LinkLostError("the port is gone")
        self.written += data[: self.most]
        return min(self.most, len(data))


def session_on(port: SlowPort) -> tuple[Session, VirtualClock]:
    clock = VirtualClock(0)
    return Session(Link(LinkConfiguration(2)), port, clock.now_ns), clock


def test_what_a_port_does_not_take_goes_first_the_next_time() -> None:
    rng, port = random.Random(1), SlowPort()
    session, clock = session_on(port)
    session.connect()
    for _ in range(400):
        port.most = rng.randrange(4)
        session.send()
        clock.time_ns += 2 * MS
    port.most = 1_000
    while session.wants_to_write():
        session.send()
    items = FrameDecoder(2).receive(port.written)
    requests = [decode_body(item)[1] for item in items if isinstance(item, bytes)]
    assert len(requests) >= 5 and all(isinstance(request, HelloRequest) for request in requests)
    # Nothing was lost, doubled or mixed: the greetings are numbered without a gap.
    sequences = [decode_body(item)[0] for item in items if isinstance(item, bytes)]
    assert sequences == list(range(1, len(sequences) + 1))


@pytest.mark.parametrize("begin", ["connect", "lose_port", "move_to"])
def test_the_rest_of_an_old_frame_is_never_sent_in_a_new_session(begin: str) -> None:
    port, other = SlowPort(most=3), SlowPort()
    session, _ = session_on(port)
    session.connect()
    session.send()
    assert session.wants_to_write()
    if begin == "move_to":
        session.move_to(other)
        session.send()
        assert len(FrameDecoder(2).receive(other.written)) == 1 and len(port.written) == 3
    else:
        getattr(session, begin)()
        assert not session.wants_to_write()


def test_a_port_that_is_gone_ends_the_session() -> None:
    port = SlowPort()
    session, _ = session_on(port)
    session.connect()
    port.is_gone = True
    with pytest.raises(LinkLostError):
        session.exchange()
    port.is_gone = False
    assert session.link.outgoing(10**9) == b""


def test_a_device_that_says_nothing_is_given_up() -> None:
    session, clock = session_on(SlowPort())
    session.connect()
    session.exchange()
    assert not session.must_receive()
    clock.time_ns = 60_000 * MS
    assert session.must_receive()
    with pytest.raises(LinkLostError):
        session.receive()


def test_a_lost_port_is_closed_and_opened_again_once_after_pauses_from_a_tenth_of_a_second_to_two() -> None:
    line = VirtualLine()
    reopening = ReopeningPort(line.open)
    assert reopening.poll(0) is reopening.poll(0) is line
    assert (reopening.next_attempt_ns(), len(line.openings_ns)) == (None, 1)
    line.unplug(1_000 * MS)
    reopening.lose(0)
    assert not line.is_open
    attempts_ns = [0]
    for _ in range(8):
        due_ns = reopening.next_attempt_ns()
        assert due_ns is not None
        assert reopening.poll(due_ns - 1) is None
        assert reopening.poll(due_ns) is None
        attempts_ns.append(due_ns)
    pauses_ms = [(b - a) // MS for a, b in itertools.pairwise(attempts_ns)]
    assert pauses_ms == [100, 100, 200, 400, 800, 1600, 2000, 2000]
    assert (FIRST_PAUSE_NS, LONGEST_PAUSE_NS) == (100 * MS, 2000 * MS)
    assert (reopening.attempts, reopening.reason) == (8, "no serial port 'bar'")
    line.clock.run_to(line.time_ns + 1_000 * MS)
    assert reopening.poll(attempts_ns[-1] + 2_000 * MS) is line
    assert line.is_open and not line.written
    reopening.lose(20_000 * MS)
    assert (reopening.attempts, reopening.next_attempt_ns()) == (0, 20_100 * MS)


def test_a_device_is_looked_for_by_the_name_that_stays() -> None:
    ports = (PortDescription("/dev/ttyACM0", "/dev/serial/by-id/usb-bar", "bar"),)
    assert stable_name_of("/dev/ttyACM0", lambda: ports) == "/dev/serial/by-id/usb-bar"
    assert stable_name_of("/dev/serial/by-id/usb-bar", lambda: ports) == "/dev/serial/by-id/usb-bar"
    assert stable_name_of("/dev/ttyS9", lambda: ports) == "/dev/ttyS9"
