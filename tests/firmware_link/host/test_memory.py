"""A basis that changes while its device is armed, in virtual time."""

import numpy as np
import pytest

from firmware_link.emulator import Cause, DeviceConfiguration, EmulatedFirmware
from firmware_link.host.link import Link
from firmware_link.host.link_values import BasisRefused, BasisReplaced, Event, LinkConfiguration, LinkState
from firmware_link.protocol.errors import LinkError
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import BasisCommit, DeviceState, Result
from tests.firmware_link.clicks import Clicks

MS = 1_000_000
STEP_NS = 250_000


def hump(*amplitudes: float, count: int = 81) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    rise = np.sin(np.pi * np.linspace(0, 1, count)) ** 2
    rise[-1] = 0.0
    return np.outer(rise, amplitudes)


OLD = Clicks(4000, [hump(1.0, 0.0)] * 4)
NEW = Clicks(4000, [hump(0.0, 0.5, count=161)] * 15)


class Rig:
    """An armed link and its device; a frame may be lost on the way there."""

    def __init__(self, capacity_bytes: int = 1 << 16) -> None:
        self.link = Link(LinkConfiguration(2, basis=OLD.basis, bit_rate_hz=2_000_000))
        self.firmware = EmulatedFirmware(DeviceConfiguration(1, basis_capacity_bytes=capacity_bytes))
        self.time_ns = 1_000 * MS
        self.events: list[Event] = []
        self.loses: set[int] = set()
        self.frames = 0
        self.link.connect(self.time_ns)
        self.pass_until(lambda: self.link.state is LinkState.READY)

    def step(self) -> None:
        self.time_ns += STEP_NS
        data = self.link.outgoing(self.time_ns)
        self.frames += bool(data)
        answer = self.firmware.receive(b"" if self.frames in self.loses and data else data, self.time_ns // 1000)
        self.events += self.link.receive(answer + self.firmware.advance(self.time_ns // 1000), self.time_ns)
        self.link.poll(self.time_ns)

    def pass_until(self, is_over: object, most: int = 40_000) -> None:
        for _ in range(most):
            if is_over():  # type: ignore[operator]  # a function
                return
            self.step()
        raise AssertionError("it does not end")

    def end(self) -> Event | None:
        """What the transfer came to."""
        return next((event for event in self.events if isinstance(event, BasisReplaced | BasisRefused)), None)

    def ends(self) -> bool:
        return self.end() is not None

    def transfers(self, step: type[Message]) -> bool:
        """Whether this step is the next to be sent or answered."""
        transfer = self.link._memory._transfer
        return transfer is not None and isinstance(transfer._step, step)

    def played(self) -> list[int]:
        """Number of samples of each click that the firmware began: 81 of the old basis, 161 of the new one."""
        return [len(e.waveform.samples) for e in self.firmware.drive_log if e.waveform is not None]


def test_the_old_basis_plays_until_the_new_one_is_whole() -> None:
    rig = Rig()
    rig.link.replace_basis(NEW.basis)
    due_ns = rig.time_ns + 5 * MS
    while not rig.ends():
        if rig.time_ns >= due_ns and not rig.link._outbox.holds_clicks:
            rig.link.set_play(OLD.encoded(3))
            due_ns += 25 * MS
        rig.step()
    assert isinstance(rig.end(), BasisReplaced)
    before = rig.played()
    assert len(before) > 3
    assert set(before) == {81}
    rig.link.set_play(NEW.encoded(14))
    rig.pass_until(lambda: len(rig.played()) > len(before))
    assert rig.played()[-1] == 161
    assert rig.firmware.state is DeviceState.DRIVING
    assert all(event.cause is not Cause.LEASE_EXPIRED for event in rig.firmware.drive_log)


@pytest.mark.parametrize("lost", range(1, 90, 7))
def test_a_step_that_is_lost_is_sent_again(lost: int) -> None:
    rig = Rig()
    rig.link.replace_basis(NEW.basis)
    rig.loses = {rig.frames + lost, rig.frames + lost + 1}
    rig.pass_until(rig.ends)
    assert isinstance(rig.end(), BasisReplaced)
    assert rig.firmware.state is DeviceState.ARMED


def test_a_click_of_the_old_basis_that_waits_while_the_device_changes_over_is_dropped() -> None:
    rig = Rig()
    rig.link.replace_basis(NEW.basis)
    rig.pass_until(lambda: rig.transfers(BasisCommit))
    rig.loses = {rig.frames + 1}
    rig.pass_until(lambda: rig.link._outbox.holds_clicks)
    rig.link.set_play(OLD.encoded(2))
    for _ in range(20):
        rig.step()
    assert not rig.played()
    rig.pass_until(rig.ends)
    with pytest.raises(LinkError, match="made of another basis"):
        rig.link.set_play(OLD.encoded(2))
    rig.link.set_play(NEW.encoded(2))
    rig.pass_until(lambda: bool(rig.played()))
    assert rig.played() == [161]
    assert rig.link.counters.coalesced == 1


def test_commands_go_out_between_the_steps() -> None:
    rig = Rig()
    rig.link.replace_basis(NEW.basis)
    asked, waited = 0, []
    while not rig.ends():
        rig.link.set_drive(bytes([1, 0, asked % 200 + 1, 0, 0, 0] * 2))
        sent, start_ns = rig.link.counters.sent, rig.time_ns
        rig.pass_until(lambda sent=sent: rig.link.counters.sent > sent)
        waited.append(rig.time_ns - start_ns)
        asked += 1
        for _ in range(20):
            rig.step()
    assert isinstance(rig.end(), BasisReplaced)
    assert max(waited) <= 8 * MS
    assert rig.firmware.counters.stale == 0


def test_a_device_without_room_for_both_refuses_and_plays_on() -> None:
    rig = Rig(capacity_bytes=len(NEW.basis.data) + 10)
    rig.link.replace_basis(NEW.basis)
    rig.pass_until(rig.ends)
    assert rig.end() == BasisRefused(Result.NO_ROOM)
    rig.link.set_play(OLD.encoded(3))
    rig.pass_until(lambda: bool(rig.played()))
    assert rig.played() == [81]


def test_a_basis_that_no_room_would_hold_is_refused_at_once() -> None:
    rig = Rig(capacity_bytes=len(NEW.basis.data) - 10)
    with pytest.raises(LinkError, match="the device holds"):
        rig.link.replace_basis(NEW.basis)


def test_a_stop_ends_the_transfer_and_the_old_basis_stays() -> None:
    rig = Rig()
    rig.link.replace_basis(NEW.basis)
    for _ in range(40):
        rig.step()
    rig.link.stop(rig.time_ns)
    rig.pass_until(lambda: rig.link.state is LinkState.STOPPED)
    with pytest.raises(LinkError, match="armed"):
        rig.link.replace_basis(NEW.basis)
    rig.link.connect(rig.time_ns)
    rig.pass_until(lambda: rig.link.state is LinkState.READY)
    assert not rig.ends()
    assert rig.link.capabilities is not None
    assert rig.link.capabilities.held_basis_hash == OLD.basis.hash
