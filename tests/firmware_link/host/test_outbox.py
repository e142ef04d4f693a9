"""Laws of the outbox: one slot, renewals in time, and never more frames within a lease than a sequence tells apart."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from firmware_link.host.clock import DeviceClock, Exchange
from firmware_link.host.link_values import LinkCounters
from firmware_link.host.outbox import Outbox
from firmware_link.protocol.basis import EncodedClick
from firmware_link.protocol.framing import FrameDecoder, FrameEncoder
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import KeepAlive, Play, Set, SetFlag, decode_body, encode_play
from tests.firmware_link.strategies import unhurried

LEASE_MS = 40
MS = 1_000_000
SILENCE = bytes(12)
DRIVE = b"\x01" * 12

Sent = list[tuple[int, Message]]


def outbox() -> Outbox:
    box = Outbox(LinkCounters(), 200, FrameEncoder())
    begin_session(box)
    return box


def begin_session(box: Outbox) -> None:
    clock = DeviceClock()
    clock.update(Exchange(0, 0, 0, 0))
    box.start(SILENCE, LEASE_MS, clock)


def click(length_us: int) -> EncodedClick:
    return EncodedClick(encode_play(0, 14, 65_535, [1, 2, 3]), length_us, 65_535, 1)


def next_of(box: Outbox, now_ns: int) -> Message | None:
    bodies = FrameDecoder(2).receive(box.next_frame(now_ns))
    return decode_body(bodies[0])[1] if bodies and isinstance(bodies[0], bytes) else None


def run(box: Outbox, start_ns: int, stop_ns: int, step_ns: int, wanted: bytes | EncodedClick | None) -> Sent:
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
    wanted = click(30_000) if plays else DRIVE
    sent = run(outbox(), 0, 100 * MS, step_ns, wanted)
    times_ns = [time_ns for time_ns, _ in sent]
    assert all(last - first >= LEASE_MS * MS for first, last in zip(times_ns, times_ns[127:], strict=False))


def test_a_drive_is_renewed_three_times_a_lease_and_silence_each_80_ms_whatever_sounded_before() -> None:
    box = outbox()
    for before, drive, period_ns in ((click(2**30), DRIVE, LEASE_MS * MS // 3), (DRIVE, SILENCE, 80 * MS)):
        box.put(before)
        assert next_of(box, 0)
        box.put(drive)
        sent = run(box, MS, 400 * MS, 100_000, None)
        assert {type(message) for _, message in sent} == {Set}
        times_ns = [time_ns for time_ns, _ in sent]
        assert max(later - earlier for earlier, later in itertools.pairwise(times_ns)) <= period_ns + 100_000
        begin_session(box)


def test_a_click_is_kept_alive_by_its_own_sequence_until_a_lease_after_its_end_then_silence_is_sent() -> None:
    box = outbox()
    box.put(click(200_000))
    sent = run(box, 0, 400 * MS, 100_000, None)
    assert [type(message) for _, message in sent] == [Play, KeepAlive, KeepAlive, Set, Set]
    assert {m.applied_sequence for _, m in sent if isinstance(m, KeepAlive)} == {box.drive_sequence}
    first_set_ns, silence = next((time_ns, m) for time_ns, m in sent if isinstance(m, Set))
    assert first_set_ns == (200 + LEASE_MS) * MS
    assert silence.drive == SILENCE


def test_what_is_cleared_is_not_sent() -> None:
    box = outbox()
    box.put(DRIVE)
    assert not box.is_silent
    box.clear()
    assert box.is_silent
    assert all(message.drive == SILENCE for _, message in run(box, 0, 100 * MS, MS, None) if isinstance(message, Set))


def test_a_drive_that_glides_writes_no_phase_at_its_renewals_either_and_the_next_drive_does() -> None:
    box, glided = outbox(), b"\x02" * 12
    box.put_drive(DRIVE)
    first = next_of(box, MS)
    box.put_drive(glided, writes_phase=False)
    later = [next_of(box, 2 * MS), next_of(box, 2 * MS + box.lease.renewal_ns)]
    box.put_drive(DRIVE)
    last = next_of(box, 100 * MS)
    assert isinstance(first, Set) and isinstance(last, Set)
    assert [first.flags, last.flags] == [SetFlag.WRITE_PHASE] * 2
    assert [(each.flags, each.drive) for each in later if isinstance(each, Set)] == [(SetFlag(0), glided)] * 2


def test_of_what_waits_only_a_click_is_dropped_and_counted() -> None:
    box = outbox()
    box.drop_click()
    assert box._counters.coalesced == 0
    box.put(DRIVE)
    box.drop_click()
    assert (box._counters.coalesced, isinstance(next_of(box, LEASE_MS * MS), Set)) == (0, True)
    box.put(click(1_000))
    box.drop_click()
    assert box._counters.coalesced == 1
    assert not isinstance(next_of(box, 2 * LEASE_MS * MS), Play)


def test_a_new_session_knows_of_no_click_of_the_one_before() -> None:
    box = outbox()
    for number in range(2):
        box.put(click(200_000))
        assert isinstance(next_of(box, number * MS), Play)
    assert box.free_from_ns(2 * MS)[1] > 2 * MS
    begin_session(box)
    assert box.free_from_ns(2 * MS)[1] == 2 * MS
    box.holds_clicks = True
    assert box.free_from_ns(2 * MS)[1] == 2**63 - 1, "never, as a time that fits eight bytes"
