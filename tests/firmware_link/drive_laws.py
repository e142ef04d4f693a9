"""What every device of this protocol keeps to: it is armed, drives, falls silent by itself, and refuses what is old."""

import numpy as np

from firmware_link.protocol.framing import EMERGENCY_STOP, encode_message
from firmware_link.protocol.messages import (
    CLOCK_REFERENCE_SPAN,
    CLOCK_REFERENCE_US,
    Ack,
    Arm,
    DeviceState,
    Fault,
    FaultCode,
    KeepAlive,
    Log,
    LogCode,
    Result,
    Set,
    SetFlag,
    Status,
    Stop,
)
from tests.firmware_link.law_host import (
    CLICKS,
    DISARM_US,
    FULL,
    LOUD,
    PATIENCE_US,
    RAMP_US,
    SLEW_PER_S,
    US_PER_MS,
    US_PER_S,
    Host,
    Tier,
    with_basis,
)


def law_nothing_drives_before_it_is_armed(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    host.send(host.set_message(host.drive(*LOUD)))
    host.send(CLICKS.play(0, host.clock_reference()))
    status = host.status(lambda status: status.refused == 2)
    assert (status.state, status.applied) == (DeviceState.IDLE, 0)
    host.pass_until(status.device_time_us + RAMP_US)
    assert max(tier.peaks(0, status.device_time_us + RAMP_US)) == 0.0


def law_only_this_boot_is_armed_and_only_within_range(tier: Tier) -> None:
    host = Host(tier)
    hello = host.greet()
    assert host.arm(boot_id=hello.boot_id ^ 1) is Result.WRONG_BOOT
    limits = (FULL,) * hello.number_of_actuators
    for slew_per_s, lease_ms in ((0, 40), (SLEW_PER_S, 0), (SLEW_PER_S, hello.longest_lease_ms + 1)):
        assert host.ask(Arm(hello.boot_id, slew_per_s, lease_ms, 0, limits)) is Result.OUT_OF_RANGE
    host.send(host.set_message(host.drive(*LOUD)))
    assert host.status(lambda status: status.refused == 5).state is DeviceState.IDLE
    assert host.arm() is Result.OK


def law_a_driving_device_is_not_armed_anew(tier: Tier) -> None:
    host = Host(tier).ready()
    host.set(host.drive(*LOUD))
    assert host.arm() is Result.WRONG_STATE


def law_a_rebooted_device_is_not_driven_by_old_traffic(tier: Tier) -> None:
    host = Host(tier).ready()
    assert host.hello is not None
    drive = host.drive(*LOUD)
    old = host.frame(Arm(host.hello.boot_id, SLEW_PER_S, tier.lease_ms, 0, (FULL,) * host.hello.number_of_actuators))
    # Every time that the device may have: none of them helps without the new boot.
    references = range(0, CLOCK_REFERENCE_SPAN, 16 * CLOCK_REFERENCE_US)
    sets = [host.frame(Set(at, SetFlag.WRITE_PHASE, tier.lease_ms, drive)) for at in references]
    tier.reboot()
    for frame in (old, *sets):
        tier.write(frame)
    reborn = Host(tier)
    hello = reborn.greet()
    assert hello.boot_id != host.hello.boot_id
    status = reborn.status()
    assert (status.state, status.applied) == (DeviceState.IDLE, 0)
    reborn.pass_until(status.device_time_us)
    assert max(tier.peaks(0, status.device_time_us)) == 0.0


def law_the_first_greeting_of_a_boot_is_told(tier: Tier) -> None:
    for _ in range(2):
        host = Host(tier)
        host.greet()
        host.greet()
        host.fresh_status()
        assert [m.code for m in host.heard if isinstance(m, Log)] == [LogCode.BOOTED]
        tier.reboot()


def law_a_copy_is_refused_as_long_as_the_clock_lets_it_pass(tier: Tier) -> None:
    """A frame may seem a lease young, and then its copy passes the clock for two leases."""
    host = Host(tier).ready()
    drive, lease_us = host.drive(*LOUD), tier.lease_ms * US_PER_MS
    cases = [(0, 0), (lease_us // 2, lease_us * 5 // 4)] + [(lease_us, 2 * lease_us)] * (tier.slack_us == 0)
    for young_us, later_us in cases:
        before = host.fresh_status()
        frame = host.frame(host.set_message(drive, age_us=-young_us))
        tier.write(frame)
        tier.wait(later_us)
        tier.write(frame)
        after = host.fresh_status()
        assert (after.applied - before.applied, after.stale - before.stale) == (1, 1)


def law_a_drive_ends_with_its_lease(tier: Tier) -> None:
    host = Host(tier).ready()
    applied = host.set(host.drive(*LOUD))
    ended = host.ended()
    lease_us = tier.lease_ms * US_PER_MS
    assert lease_us <= ended.device_time_us - applied.applied_time_us <= lease_us + tier.slack_us
    assert ended.trips == 1
    host.expect_silence(ended.device_time_us + RAMP_US + tier.slack_us)
    assert min(tier.peaks(applied.applied_time_us, ended.device_time_us)[:2]) > 0.4
    assert LogCode.LEASE_EXPIRED in {m.code for m in host.heard if isinstance(m, Log)}


def law_a_set_gets_the_lease_that_it_asks_for_within_the_armed_one(tier: Tier) -> None:
    host = Host(tier).ready()
    for asked_ms, granted_ms in ((tier.lease_ms // 2, tier.lease_ms // 2), (255, tier.lease_ms)):
        applied = host.set(host.drive(*LOUD), asked_ms)
        ended = host.ended()
        assert 0 <= ended.device_time_us - applied.applied_time_us - granted_ms * US_PER_MS <= tier.slack_us


def law_a_silent_host_latches_the_device(tier: Tier) -> None:
    host = Host(tier).ready()
    drive = host.drive(*LOUD)
    applied = host.set(drive)
    latched = host.status(lambda status: status.state is DeviceState.LATCHED)
    silent_us = latched.device_time_us - applied.applied_time_us
    assert DISARM_US <= silent_us <= DISARM_US + tier.slack_us
    assert latched.fault is FaultCode.SILENT_HOST
    assert host.expect(Fault).fault is FaultCode.SILENT_HOST
    host.send(host.set_message(drive))
    assert host.arm() is Result.WRONG_STATE
    assert host.fresh_status().state is DeviceState.LATCHED
    again = Host(tier).ready()
    assert again.set(drive).state is DeviceState.DRIVING


def law_a_fault_repeats_until_acknowledged(tier: Tier) -> None:
    host = Host(tier).ready()
    first, second = host.expect(Fault), host.expect(Fault)
    assert first == second
    for sequence in range(256):
        tier.write(host.frame(Ack(Fault.type_byte, sequence, Result.OK)))
    assert host.fresh_status().fault is FaultCode.NONE
    host.listen()
    host.heard.clear()
    tier.wait(300 * US_PER_MS)
    host.fresh_status()
    assert not [m for m in host.heard if isinstance(m, Fault)]


def law_eight_zeros_latch(tier: Tier) -> None:
    for is_armed in (False, True):
        host = Host(tier)
        host.greet()
        if is_armed:
            assert host.arm() is Result.OK
            host.set(host.drive(*LOUD))
        tier.write(EMERGENCY_STOP)
        latched = host.status(lambda status: status.state is DeviceState.LATCHED)
        assert latched.fault is FaultCode.EMERGENCY_STOP
        host.expect_silence(latched.device_time_us + RAMP_US)
        assert host.arm() is Result.WRONG_STATE


def law_stop_latches(tier: Tier) -> None:
    host = Host(tier).ready()
    drive = host.drive(*LOUD)
    host.set(drive)
    assert host.ask(Stop()) is Result.OK
    host.send(host.set_message(drive))
    assert host.fresh_status().state is DeviceState.LATCHED
    assert host.arm() is Result.WRONG_STATE


def law_a_new_session_disarms(tier: Tier) -> None:
    host = Host(tier).ready()
    host.set(host.drive(*LOUD))
    host.greet()
    status = host.fresh_status()
    assert status.state is DeviceState.IDLE
    host.expect_silence(status.device_time_us + RAMP_US)


def law_a_device_driven_too_long_latches(tier: Tier) -> None:
    host = Host(tier).ready(longest_drive_s=1)
    drive = host.drive(*LOUD)
    latched: list[Status] = []
    started = host.set(drive).applied_time_us
    end_us = tier.now_us() + PATIENCE_US
    while not latched and tier.now_us() < end_us:
        host.send(host.set_message(drive))
        tier.wait(10 * US_PER_MS)
        latched = [m for m in host.listen() if isinstance(m, Status) and m.state is DeviceState.LATCHED]
    assert [status.fault for status in latched[:1]] == [FaultCode.DRIVEN_TOO_LONG]
    assert 0 <= latched[0].device_time_us - started - US_PER_S <= tier.slack_us


def law_a_pause_starts_the_time_on_anew(tier: Tier) -> None:
    host = Host(tier).ready(longest_drive_s=1)
    drive = host.drive(*LOUD)
    for _ in range(3):
        end_us = tier.now_us() + 800 * US_PER_MS
        while tier.now_us() < end_us:
            host.send(host.set_message(drive))
            tier.wait(10 * US_PER_MS)
        host.set(bytes(len(drive)))
    assert host.fresh_status().state is DeviceState.ARMED


def law_keepalives_renew_and_no_more(tier: Tier) -> None:
    host = Host(tier).ready()
    applied = host.set(host.drive(*LOUD))
    named = applied.applied_sequence
    for _ in range(30):
        host.send(KeepAlive(host.clock_reference(), named))
        tier.wait(10 * US_PER_MS)
    host.listen()
    assert not any(isinstance(m, Status) and m.trips for m in host.heard) or tier.slack_us
    # One that names another drive is no renewal, but the host lives; and none brings a drive back.
    last_us = host.device_us()
    for name in (named ^ 1, named):
        for _ in range(30):
            host.send(KeepAlive(host.clock_reference(), name))
            tier.wait(10 * US_PER_MS)
        ended = host.fresh_status()
        assert (ended.state, ended.applied, ended.trips) == (DeviceState.ARMED, applied.applied, 1)
    tripped = next(m for m in host.heard if isinstance(m, Status) and m.trips)
    assert tripped.device_time_us <= last_us + tier.lease_ms * US_PER_MS + tier.slack_us


def law_an_old_clock_or_sequence_is_stale(tier: Tier) -> None:
    host = with_basis(tier)
    drive = host.drive(*LOUD)
    lease_us = tier.lease_ms * US_PER_MS

    def send_each(age_us: int) -> None:
        at = host.clock_reference(age_us)
        for message in (host.set_message(drive, age_us=age_us), CLICKS.play(0, at), KeepAlive(at, 0)):
            host.send(message)

    before = host.fresh_status()
    for age_us in (2 * lease_us, -2 * lease_us, 10 * lease_us):
        send_each(age_us)
    assert host.status(lambda status: status.stale == before.stale + 9).applied == before.applied
    driven = host.set(drive)
    host.sequence = (host.sequence - 10) % 256
    send_each(0)
    assert host.status(lambda status: status.stale >= driven.stale + 3).applied == driven.applied


def law_any_garbage_ends_at_the_next_delimiter(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    noise = np.random.default_rng(1)
    for size in (1, 7, 60, 300, 2000):
        garbage = bytes(noise.integers(1, 256, size, dtype=np.uint8))
        for end in (b"", host.frame(Stop())[:-2]):
            tier.write(garbage + end + b"\0")
            host.compare_clocks()
    assert host.fresh_status().state is DeviceState.IDLE


def law_counters_tell_what_came(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    before = host.fresh_status()
    good = host.frame(KeepAlive(0, 0))
    too_long = bytes([0x55]) * 3000 + b"\0"
    other_length = encode_message(Set(0, SetFlag.WRITE_PHASE, 40, bytes(6)), 1)
    no_code = b"\xff\x01\0"
    damaged = bytes([*good[:-3], good[-3] ^ 0x55 or 0x01, *good[-2:]])
    for data, times in ((good, 5), (too_long, 2), (other_length, 3), (no_code, 4), (damaged, 6)):
        for _ in range(times):
            tier.write(data)
    seen = host.status(lambda status: status.crc == before.crc + 6)
    # The comparison of clocks and what follows are frames too.
    assert (seen.refused, seen.overrun, seen.length, seen.framing) == (
        before.refused + 5,
        before.overrun + 2,
        before.length + 3,
        before.framing + 4,
    )
    assert seen.ok == before.ok + 5


def law_status_comes_ten_times_a_second(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    first = host.fresh_status()
    following = [host.status() for _ in range(5)]
    assert following[-1].device_time_us - first.device_time_us >= 450 * US_PER_MS
