"""A basis that changes while its device is armed, in virtual time."""

import pytest

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause
from firmware_link.host.link_values import BasisRefused, BasisReplaced, Event, LinkConfiguration, LinkState
from firmware_link.protocol.layout import Message
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import BasisCommit, DeviceState, Result
from tests.firmware_link.law_host import Clicks, hump
from tests.firmware_link.virtual_rig import BOOT_ID, VirtualRig
from tests.tools.virtual import MS

OLD = Clicks(4000, [hump(1.0, 0.0)] * 4)
NEW = Clicks(4000, [hump(0.0, 0.5, duration_us=80_000)] * 15)


class Rig(VirtualRig):
    """An armed session with a basis; frames are lost by their numbers."""

    def __init__(self, capacity_bytes: int = 1 << 16) -> None:
        self.lost: set[int] = set()
        super().__init__(
            LinkConfiguration(2, basis=OLD.basis, bit_rate_hz=2_000_000),
            DeviceConfiguration(BOOT_ID, basis_capacity_bytes=capacity_bytes),
            delay_ns=100_000,
        )
        self.connect()

    def loses(self, number: int) -> bool:
        return number in self.lost

    def lose(self, *later: int) -> None:
        """The frames so many after the last one are lost."""
        self.lost = {len(self.line.written) + each for each in later}

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


def replacing(**settings: int) -> Rig:
    """A session in which the transfer of the new basis has begun."""
    rig = Rig(**settings)
    rig.link.replace_basis(NEW.basis)
    return rig


def test_the_old_basis_plays_until_the_new_one_is_whole() -> None:
    rig = replacing()
    due_ns = rig.now_ns + 5 * MS
    while not rig.ends():
        if rig.now_ns >= due_ns and not rig.link._outbox.holds_clicks:
            rig.link.set_play(OLD.encoded(3))
            due_ns += 25 * MS
        rig.step()
    assert isinstance(rig.end(), BasisReplaced)
    before = rig.played()
    assert len(before) > 3
    assert set(before) == {81}
    rig.link.set_play(NEW.encoded(14))
    rig.run_until(lambda: len(rig.played()) > len(before))
    assert rig.played()[-1] == 161
    assert rig.firmware.state is DeviceState.DRIVING
    assert all(event.cause is not Cause.LEASE_EXPIRED for event in rig.firmware.drive_log)


@pytest.mark.parametrize("lost", range(1, 90, 7))
def test_a_step_that_is_lost_is_sent_again(lost: int) -> None:
    rig = replacing()
    rig.lose(lost, lost + 1)
    rig.run_until(rig.ends)
    assert isinstance(rig.end(), BasisReplaced)
    assert rig.firmware.state is DeviceState.ARMED


def test_a_click_of_the_old_basis_that_waits_while_the_device_changes_over_is_dropped() -> None:
    rig = replacing()
    rig.run_until(lambda: rig.transfers(BasisCommit))
    rig.lose(1)
    rig.run_until(lambda: rig.link._outbox.holds_clicks)
    rig.link.set_play(OLD.encoded(2))
    for _ in range(20):
        rig.step()
    assert not rig.played()
    rig.run_until(rig.ends)
    with pytest.raises(LinkError, match="made of another basis"):
        rig.link.set_play(OLD.encoded(2))
    rig.link.set_play(NEW.encoded(2))
    rig.run_until(lambda: bool(rig.played()))
    assert rig.played() == [161]
    assert rig.link.counters.coalesced == 1


def test_commands_go_out_between_the_steps() -> None:
    rig = replacing()
    asked, waited = 0, []
    while not rig.ends():
        rig.link.set_drive(bytes([1, 0, asked % 200 + 1, 0, 0, 0] * 2))
        sent, start_ns = rig.link.counters.sent, rig.now_ns
        rig.run_until(lambda sent=sent: rig.link.counters.sent > sent)  # type: ignore[misc]
        waited.append(rig.now_ns - start_ns)
        asked += 1
        for _ in range(20):
            rig.step()
    assert isinstance(rig.end(), BasisReplaced)
    assert max(waited) <= 8 * MS
    assert rig.firmware.counters.stale == 0


def test_a_device_without_room_for_both_refuses_and_plays_on_and_too_large_a_basis_is_refused_at_once() -> None:
    rig = replacing(capacity_bytes=len(NEW.basis.data) + 10)
    rig.run_until(rig.ends)
    assert rig.end() == BasisRefused(Result.NO_ROOM)
    rig.link.set_play(OLD.encoded(3))
    rig.run_until(lambda: bool(rig.played()))
    assert rig.played() == [81]
    with pytest.raises(LinkError, match="the device holds"):
        replacing(capacity_bytes=len(NEW.basis.data) - 10)


def test_a_stop_ends_the_transfer_and_the_old_basis_stays() -> None:
    rig = replacing()
    for _ in range(40):
        rig.step()
    rig.link.stop(rig.now_ns)
    rig.run_until(lambda: rig.link.state is LinkState.STOPPED)
    with pytest.raises(LinkError, match="armed"):
        rig.link.replace_basis(NEW.basis)
    rig.link.connect(rig.now_ns)
    rig.run_until(lambda: rig.link.state is LinkState.READY)
    assert not rig.ends()
    assert rig.link.capabilities is not None
    assert rig.link.capabilities.held_basis_hash == OLD.basis.hash
