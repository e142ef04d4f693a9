"""Laws of the session: whatever a port takes at a time, the bytes of the link arrive whole and in order."""

import random

import pytest

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration
from firmware_link.host.session import Session
from firmware_link.protocol.framing import FrameDecoder
from firmware_link.protocol.link_errors import LinkLostError
from firmware_link.protocol.messages import HelloRequest, decode_body
from tests.tools.virtual import MS, VirtualClock


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
