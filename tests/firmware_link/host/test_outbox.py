"""Laws of the outbox: one slot, renewals in time, and never more frames within a lease than a sequence tells apart."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from firmware_link.host.link_values import LinkCounters
from firmware_link.host.outbox import Outbox, WantedDrive, WantedWaveform
from firmware_link.protocol.messages import KeepAlive, Play, Set, SetFlag
from tests.firmware_link.strategies import unhurried

LEASE_MS = 40
MS = 1_000_000
SILENCE = bytes(12)
DRIVE = b"\x01" * 12

Sent = list[tuple[int, Set | Play | KeepAlive]]


def outbox() -> Outbox:
    box = Outbox(LinkCounters(), 200)
    box.start(SILENCE, LEASE_MS)
    return box


def next_of(box: Outbox, now_ns: int) -> Set | Play | KeepAlive | None:
    """As a link asks: a command first."""
    wanted = box.next_command(now_ns)
    if isinstance(wanted, WantedWaveform):
        return Play(0, wanted.waveform, wanted.amplitude)
    if wanted is not None:
        return Set(0, SetFlag.WRITE_PHASE, LEASE_MS, wanted.drive)
    return box.next_message(now_ns, lambda _: 0, 7)[0]


def run(box: Outbox, start_ns: int, stop_ns: int, step_ns: int, wanted: WantedDrive | WantedWaveform | None) -> Sent:
    """Ask as often as each step, wanting something anew each time."""
    sent: Sent = []
    for now_ns in range(start_ns, stop_ns, step_ns):
        if wanted is not None:
            box.put(wanted)
        due_ns = box.due_ns(now_ns)
        message = next_of(box, now_ns)
        assert (message is not None) == (due_ns <= now_ns)
        if message is not None:
            sent.append((now_ns, message))
    return sent


@unhurried
@given(st.integers(10_000, 400_000), st.booleans())
def test_no_lease_has_more_frames_than_a_sequence_tells_apart(step_ns: int, plays: bool) -> None:
    wanted = WantedWaveform(0, 65_535, 30_000) if plays else WantedDrive(DRIVE)
    sent = run(outbox(), 0, 100 * MS, step_ns, wanted)
    times_ns = [time_ns for time_ns, _ in sent]
    assert all(last - first >= LEASE_MS * MS for first, last in zip(times_ns, times_ns[127:], strict=False))


def test_a_drive_is_renewed_three_times_a_lease_and_silence_each_80_ms() -> None:
    for drive, period_ns in ((DRIVE, LEASE_MS * MS // 3), (SILENCE, 80 * MS)):
        box = outbox()
        box.put(WantedDrive(drive))
        times_ns = [time_ns for time_ns, _ in run(box, 0, 400 * MS, 10_000, None)]
        assert max(later - earlier for earlier, later in itertools.pairwise(times_ns)) <= period_ns + 10_000


def test_a_waveform_is_kept_alive_by_its_own_sequence_until_a_lease_after_its_end_then_silence_is_sent() -> None:
    box = outbox()
    box.put(WantedWaveform(3, 65_535, 200_000))
    sent = run(box, 0, 400 * MS, 100_000, None)
    assert [type(message) for _, message in sent] == [Play, KeepAlive, KeepAlive, Set, Set]
    assert {m.applied_sequence for _, m in sent if isinstance(m, KeepAlive)} == {7}
    first_set_ns, silence = next((time_ns, m) for time_ns, m in sent if isinstance(m, Set))
    assert first_set_ns == (200 + LEASE_MS) * MS
    assert silence.drive == SILENCE


def test_what_is_cleared_is_not_sent() -> None:
    box = outbox()
    box.put(WantedDrive(DRIVE))
    assert not box.is_silent
    box.clear()
    assert box.is_silent
    assert all(message.drive == SILENCE for _, message in run(box, 0, 100 * MS, MS, None) if isinstance(message, Set))


@unhurried
@given(st.lists(st.tuples(st.integers(0, 5_000_000), st.one_of(st.none(), st.binary(min_size=12, max_size=12)))))
def test_the_quick_way_sends_what_the_other_way_sends_at_the_same_times(
    steps: list[tuple[int, bytes | None]],
) -> None:
    quick, plain, now_ns = outbox(), outbox(), 0
    for step_ns, drive in steps:
        now_ns += step_ns
        if drive is not None:
            quick.put(WantedDrive(drive))
            plain.put(WantedDrive(drive))
        wanted = quick.next_command(now_ns)
        expected, _ = plain.next_message(now_ns, lambda _: 0, 7)
        if wanted is None:
            assert quick.next_message(now_ns, lambda _: 0, 7)[0] == expected
        else:
            assert isinstance(expected, Set)
            assert isinstance(wanted, WantedDrive)
            assert wanted.drive == expected.drive
        assert quick.due_ns(now_ns) == plain.due_ns(now_ns)
        assert quick.is_silent == plain.is_silent


def test_a_waveform_that_sounds_is_taken_over_the_other_way() -> None:
    box = outbox()
    box.put(WantedWaveform(0, 65_535, 200_000))
    assert isinstance(next_of(box, 0), Play)
    box.put(WantedDrive(DRIVE))
    assert box.next_command(MS) is None
    assert isinstance(box.next_message(MS, lambda _: 0, 7)[0], Set)
