"""Laws of a port that comes and goes: growing pauses, a name that stays, nothing sent by itself."""

import itertools

from firmware_link.host.reopening import FIRST_PAUSE_NS, LONGEST_PAUSE_NS, ReopeningPort, stable_name_of
from firmware_link.host.serial_port import PortDescription
from firmware_link.protocol.errors import LinkError

MS = 1_000_000


class Socket:
    """A place where a port is, or not."""

    def __init__(self) -> None:
        self.is_there = True
        self.opened: list[FakePort] = []

    def open(self) -> "FakePort":
        if not self.is_there:
            raise LinkError("no serial port 'bar': plug the device in")
        self.opened.append(FakePort())
        return self.opened[-1]


class FakePort:
    """Knows whether it was given back; has nothing to send with."""

    def __init__(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False


def test_pauses_grow_from_a_tenth_of_a_second_to_two() -> None:
    socket = Socket()
    reopening = ReopeningPort(socket.open)
    assert reopening.poll(0) is socket.opened[0]
    assert reopening.next_attempt_ns() is None
    socket.is_there = False
    reopening.lose(0)
    attempts_ns = []
    for _ in range(8):
        due_ns = reopening.next_attempt_ns()
        assert due_ns is not None
        assert reopening.poll(due_ns - 1) is None
        assert reopening.poll(due_ns) is None
        attempts_ns.append(due_ns)
    pauses_ms = [(b - a) // MS for a, b in itertools.pairwise([0, *attempts_ns])]
    assert pauses_ms == [100, 100, 200, 400, 800, 1600, 2000, 2000]
    assert (FIRST_PAUSE_NS, LONGEST_PAUSE_NS) == (100 * MS, 2000 * MS)
    assert (reopening.attempts, reopening.reason) == (8, "no serial port 'bar': plug the device in")


def test_a_port_that_is_back_is_opened_once_and_the_old_one_was_closed() -> None:
    socket = Socket()
    reopening = ReopeningPort(socket.open)
    first = reopening.poll(0)
    assert first is not None
    reopening.lose(0)
    assert not first.is_open
    second = reopening.poll(200 * MS)
    assert second is reopening.poll(300 * MS) is socket.opened[1]
    reopening.lose(400 * MS)
    assert reopening.next_attempt_ns() == 500 * MS


def test_a_device_is_looked_for_by_the_name_that_stays() -> None:
    ports = (PortDescription("/dev/ttyACM0", "/dev/serial/by-id/usb-bar", "bar"),)
    assert stable_name_of("/dev/ttyACM0", lambda: ports) == "/dev/serial/by-id/usb-bar"
    assert stable_name_of("/dev/serial/by-id/usb-bar", lambda: ports) == "/dev/serial/by-id/usb-bar"
    assert stable_name_of("/dev/ttyS9", lambda: ports) == "/dev/ttyS9"
