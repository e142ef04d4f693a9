"""Laws of a port that comes and goes: growing pauses, a name that stays, nothing sent by itself."""

import itertools

from firmware_link.host.reopening import FIRST_PAUSE_NS, LONGEST_PAUSE_NS, ReopeningPort, stable_name_of
from firmware_link.host.serial_port import PortDescription
from tests.tools.virtual import MS, VirtualLine


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
