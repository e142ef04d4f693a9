"""What every device of this protocol keeps to: one law a function, over any device that a `Tier` reaches.

Times of a law are the device's own, from its STATUS, so that a slow machine or line makes no law fail. Laws of real
time are given slack by the tier.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from base.arrays import Array
from firmware_link.protocol.basis import Basis, BasisSet, encode_basis, transfer_messages
from firmware_link.protocol.framing import EMERGENCY_STOP, FrameDecoder, encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import (
    BASIS_CHUNK_SIZE,
    CLOCK_REFERENCE_SPAN,
    CLOCK_REFERENCE_US,
    MAGIC,
    MAXIMUM_WEIGHTS,
    VERSION_MAJOR,
    VERSION_MINOR,
    Ack,
    Arm,
    BasisBegin,
    BasisChunk,
    BasisCommit,
    ChannelDrive,
    DeviceState,
    Fault,
    FaultCode,
    Features,
    Hello,
    HelloRequest,
    KeepAlive,
    Log,
    LogCode,
    Play,
    Result,
    Set,
    SetFlag,
    Status,
    Stop,
    Time,
    TimeRequest,
    decode_body,
    encode_amplitude,
    encode_drive,
)
from tests.firmware_link.clicks import Clicks

US_PER_MS = 1_000
US_PER_S = 1_000_000
DISARM_US = 250 * US_PER_MS
LOG_SPACING_US = 10 * US_PER_MS
PATIENCE_US = 60 * US_PER_S
FULL = 65_535
SLEW_PER_S = 200
RAMP_US = US_PER_S // SLEW_PER_S
# One step of the synthesis, and what a fixed-point sine is off by.
ROUNDING = 1e-3
SAMPLE_RATE_HZ = 2_000
WAVEFORM_US = 40 * US_PER_MS

M = TypeVar("M", bound=Message)
T = TypeVar("T", bound="Tier")


class Tier(Protocol):
    """A device with two actuators or more that has just booted, and the line to it."""

    lease_ms: int
    """The lease that laws ask for: shorter than any stall of the tier."""
    slack_us: int
    """How late the device may act by its own clock: 0 in virtual time."""

    def now_us(self) -> int:
        """The host's clock."""

    def write(self, data: bytes) -> None:
        """The device gets these bytes now."""

    def wait(self, duration_us: int) -> None:
        """Let time pass for both: exactly as much in virtual time, else at least."""

    def read(self) -> bytes:
        """What the device has said since the last read; does not wait."""

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        """Greatest displacement of each actuator between two device times that have passed, in fractions."""

    def reboot(self) -> None:
        """Power off and on: another boot, clock at 0."""


class WaveTier(Tier, Protocol):
    """A tier in virtual time: it can tell what its actuators did, and its host can let go of the line."""

    def outputs(self, start_us: int, stop_us: int) -> tuple[float, Array]:
        """Sample rate in Hz, and displacements (time, actuator) between two device times that have passed."""

    def hang_up(self) -> None:
        """DTR drops, or the cable is pulled; the next write is from a host that has come again."""


Law = Callable[[Tier], None]
WaveLaw = Callable[[WaveTier], None]


class Click(NamedTuple):
    """The statuses that say that it is applied and that it is over, and the greatest displacements in between."""

    started: Status
    ended: Status
    peaks: tuple[float, ...]

    @property
    def duration_us(self) -> int:
        return self.ended.device_time_us - self.started.applied_time_us


def greeting(nonce: int = 1, magic: int = MAGIC) -> HelloRequest:
    """Of a host of this version."""
    return HelloRequest(magic, VERSION_MAJOR, VERSION_MINOR, nonce)


class Host:
    """Speaks to a tier frame by frame, as a law wants it."""

    def __init__(self, tier: Tier) -> None:
        self.tier = tier
        self.sequence = 0
        self.heard: list[Message] = []
        """All that was said, and what of it no `expect` has looked at yet."""
        self.unread: list[Message] = []
        self.hello: Hello | None = None
        self._decoder = FrameDecoder()
        self._offset_us = 0

    def frame(self, message: Message) -> bytes:
        self.sequence = (self.sequence + 1) % 256
        return encode_message(message, self.sequence)

    def send(self, message: Message) -> int:
        """Send now; the sequence that it got."""
        self.tier.write(self.frame(message))
        return self.sequence

    def listen(self) -> list[Message]:
        """What has been said since; everything stays in `heard` too."""
        new = [decode_body(item)[1] for item in self._decoder.receive(self.tier.read()) if isinstance(item, bytes)]
        self.heard += new
        self.unread += new
        return new

    def expect(self, kind: type[M], fits: Callable[[M], bool] = lambda _: True) -> M:
        """The next message of a kind that fits."""
        end_us = self.tier.now_us() + PATIENCE_US
        while self.tier.now_us() < end_us:
            self.listen()
            while self.unread:
                message = self.unread.pop(0)
                if isinstance(message, kind) and fits(message):
                    return message
            self.tier.wait(US_PER_MS)
        raise AssertionError(f"the device said no such {kind.__name__}; it said {self.heard[-5:]}")

    def ask(self, message: Message) -> Result:
        """Send what is acknowledged; the answer."""
        sequence = self.send(message)
        wanted = (message.type_byte, sequence)
        return self.expect(Ack, lambda ack: (ack.acknowledged_type, ack.acknowledged_sequence) == wanted).result

    def status(self, fits: Callable[[Status], bool] = lambda _: True) -> Status:
        return self.expect(Status, fits)

    def ended(self) -> Status:
        """The status that says that nothing drives any more, though the device is armed."""
        return self.status(lambda status: status.state is DeviceState.ARMED)

    def click(self, index: int, amplitude: float = 1.0, clicks: "Clicks | None" = None) -> "Click":
        """Play one to its end."""
        started = self.play(index, amplitude, clicks)
        ended = self.ended()
        return Click(started, ended, self.tier.peaks(started.applied_time_us, ended.device_time_us))

    def expect_silence(self, from_us: int) -> None:
        """Nothing moves from this device time on, for 20 ms."""
        until_us = from_us + 20 * US_PER_MS
        self.pass_until(until_us)
        assert max(self.tier.peaks(from_us, until_us)) == 0.0

    def fresh_status(self) -> Status:
        """A status of now: the periodic ones leave up to 100 ms after what they tell."""
        self.compare_clocks()
        now_us = self.device_us()
        return self.status(lambda status: status.device_time_us >= now_us)

    def greet(self) -> Hello:
        """A new session, clocks compared."""
        nonce = (self.sequence + 1) * 0x01010101
        self.send(greeting(nonce))
        self.hello = self.expect(Hello, lambda hello: hello.nonce == nonce)
        self.compare_clocks()
        return self.hello

    def compare_clocks(self) -> None:
        """Take the quickest of some exchanges."""
        best_us = PATIENCE_US
        for _ in range(3):
            sent_us = self.tier.now_us()
            self.send(TimeRequest(sent_us))
            time = self.expect(Time, lambda time, sent_us=sent_us: time.host_sent_ns == sent_us)  # type: ignore[misc]
            came_us = self.tier.now_us()
            if came_us - sent_us < best_us:
                best_us = came_us - sent_us
                self._offset_us = time.device_received_us - (sent_us + came_us) // 2

    def device_us(self) -> int:
        return self.tier.now_us() + self._offset_us

    def clock_reference(self, age_us: int = 0) -> int:
        return (self.device_us() - age_us) // CLOCK_REFERENCE_US % CLOCK_REFERENCE_SPAN

    def arm(self, limit: int = FULL, longest_drive_s: int = 0, boot_id: int | None = None) -> Result:
        assert self.hello is not None
        limits = (limit,) * self.hello.number_of_actuators
        boot = self.hello.boot_id if boot_id is None else boot_id
        return self.ask(Arm(boot, SLEW_PER_S, self.tier.lease_ms, longest_drive_s, limits))

    def ready(self, **limits: int) -> "Host":
        """Greeted and armed."""
        self.greet()
        assert self.arm(**limits) is Result.OK
        return self

    def drive(self, *channels: ChannelDrive) -> bytes:
        assert self.hello is not None
        spare = self.hello.number_of_actuators - len(channels)
        return encode_drive([*channels, *[ChannelDrive(0, 0)] * spare], self.hello.frequency_resolution_uhz * 1e-6)

    def set_message(self, drive: bytes, age_us: int = 0, lease_ms: int | None = None) -> Set:
        lease_ms = self.tier.lease_ms if lease_ms is None else lease_ms
        return Set(self.clock_reference(age_us), SetFlag.WRITE_PHASE, lease_ms, drive)

    def set(self, drive: bytes, lease_ms: int | None = None) -> Status:
        """Send it until it is applied; the status that says so."""
        return self._until_applied(lambda: self.set_message(drive, lease_ms=lease_ms))

    def play(self, index: int, amplitude: float = 1.0, clicks: "Clicks | None" = None) -> Status:
        """As `set`."""
        word = encode_amplitude(amplitude)
        return self._until_applied(lambda: (clicks or CLICKS).play(index, self.clock_reference(), word))

    def offer(self, data: bytes) -> Result:
        """Transfer the bytes of a basis; the answer to the last step."""
        *steps, commit = transfer_messages(data)
        for message in steps:
            assert self.ask(message) is Result.OK
        return self.ask(commit)

    def pass_until(self, device_us: int) -> None:
        """Wait until a device time has passed."""
        self.tier.wait(max(0, device_us - self.device_us()) + self.tier.slack_us + US_PER_MS)

    def _until_applied(self, make: Callable[[], Message]) -> Status:
        for _ in range(100):
            sequence = self.send(make())
            for _ in range(self.tier.lease_ms + self.tier.slack_us // US_PER_MS):
                for message in self.listen():
                    if isinstance(message, Status) and message.applied_sequence == sequence and message.applied:
                        self.unread = self.unread[self.unread.index(message) + 1 :]
                        return message
                self.tier.wait(US_PER_MS)
            self.compare_clocks()
        raise AssertionError(f"the device applied nothing; it said {self.heard[-5:]}")


LOUD = (ChannelDrive(200, 1.0), ChannelDrive(200, 0.5, math.pi / 2))


def hump(*amplitudes: float, duration_us: int = WAVEFORM_US) -> Array:
    """A waveform (sample, actuator) that rises to an amplitude and falls again, smoothly."""
    samples = np.linspace(0, 1, duration_us * SAMPLE_RATE_HZ // US_PER_S + 1)
    rise = np.sin(math.pi * samples) ** 2
    rise[-1] = 0.0
    return np.outer(rise, amplitudes)


CLICKS = Clicks(SAMPLE_RATE_HZ, [hump(1.0, -0.5), hump(0.5, 0.5)])


# ---- arming ------------------------------------------------------------------------------------------------


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


# ---- falling silent ----------------------------------------------------------------------------------------


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


# ---- fresh, and old ----------------------------------------------------------------------------------------


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


# ---- the line ----------------------------------------------------------------------------------------------


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


# ---- waveforms ---------------------------------------------------------------------------------------------


def law_a_basis_is_kept_until_the_device_boots(tier: Tier) -> None:
    host = Host(tier)
    assert host.greet().held_basis_hash == 0
    tier.wait(LOG_SPACING_US)
    steps = list(transfer_messages(CLICKS.basis.data))
    for message in steps:
        for _copy in range(2):
            assert host.ask(message) is Result.OK
    assert [m.value for m in host.heard if isinstance(m, Log)][1:] == [CLICKS.basis.hash]
    host.ready()
    host.play(0)
    assert host.ask(Stop()) is Result.OK
    for message in (*steps[:2], steps[-1]):
        assert host.ask(message) is Result.WRONG_STATE
    assert host.greet().held_basis_hash == CLICKS.basis.hash
    tier.reboot()
    assert Host(tier).greet().held_basis_hash == 0


def law_a_basis_that_is_not_whole_is_refused(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    data = CLICKS.basis.data
    begin, *chunks, commit = transfer_messages(data)
    assert isinstance(chunks[0], BasisChunk)
    damaged = dataclasses.replace(chunks[0], data=bytes(chunks[0].data[:-1]) + b"\x5a")
    assert host.ask(chunks[0]) is Result.WRONG_STATE
    for start, rest in ((begin, chunks[:-1]), (begin, [damaged, *chunks[1:]]), (BasisBegin(5, len(data)), chunks)):
        for message in (start, *rest):
            assert host.ask(message) is Result.OK
        assert host.ask(commit) is Result.WRONG_HASH
        assert host.ask(commit) is Result.WRONG_STATE
    assert host.ask(begin) is Result.OK
    assert host.ask(chunks[1]) is Result.OUT_OF_RANGE
    assert host.greet().held_basis_hash == 0
    assert host.ask(chunks[0]) is Result.WRONG_STATE


def law_a_basis_that_makes_no_sense_is_refused(tier: Tier) -> None:
    host = Host(tier)
    hello = host.greet()
    data = CLICKS.basis.data
    loud_at_the_end, loud_at_first = data[:-2] + b"\x01\x00", data[:14] + b"\x01" + data[15:]
    no_rate, no_set = b"\0\0" + data[2:], data[:2] + b"\0\0"
    of_no_actuator = data[:12] + bytes([hello.number_of_actuators]) + data[13:]
    no_function, too_many = (encode_basis(unchecked(functions)) for functions in (0, MAXIMUM_WEIGHTS + 1))
    one_more = (data + b"\0\0", data[:-1])
    for nonsense in (loud_at_the_end, loud_at_first, no_rate, no_set, of_no_actuator, no_function, too_many, *one_more):
        assert host.offer(nonsense) is Result.OUT_OF_RANGE
    # The longest is some milliseconds more than 2^32 us.
    for rate_hz, length in ((1_000, hello.longest_waveform_ms + 1), (1, 4_295), (1_000, hello.longest_waveform_ms)):
        silence = BasisSet(np.zeros((1, length + 1), np.int16), np.zeros(1, np.uint8))
        result = host.offer(Basis(rate_hz, (silence,)).data)
        assert result is (Result.OK if length == hello.longest_waveform_ms else Result.OUT_OF_RANGE)


def law_a_transfer_goes_on_whatever_is_refused_meanwhile(tier: Tier) -> None:
    """The third basis fits just before the second, behind which there is no room for what is refused."""
    first, second = (Clicks(SAMPLE_RATE_HZ, [hump(each, each, duration_us=60 * US_PER_MS)]) for each in (0.3, 0.7))
    host = Host(tier)
    capacity = host.greet().basis_capacity_bytes
    for clicks in (first, second):
        assert host.offer(clicks.basis.data) is Result.OK
    assert host.arm() is Result.OK
    data = first.basis.data
    begin, *chunks, commit = transfer_messages(data)
    assert isinstance(chunks[-1], BasisChunk)
    at = chunks[-1].offset_bytes
    chunks[-1] = BasisChunk(at, data[at:].ljust(BASIS_CHUNK_SIZE, b"\xff"))
    for step in (begin, *chunks):
        assert host.ask(step) is Result.OK
        if step is chunks[0]:
            assert host.ask(BasisBegin(7, capacity)) is Result.NO_ROOM
            assert host.ask(BasisBegin(7, capacity + 1)) is Result.NO_ROOM
            assert host.ask(BasisBegin(0, 10)) is Result.OUT_OF_RANGE
            assert host.ask(BasisChunk(1, bytes(BASIS_CHUNK_SIZE))) is Result.OUT_OF_RANGE
    assert host.ask(BasisChunk(len(data), b"\xff" * BASIS_CHUNK_SIZE)) is Result.OUT_OF_RANGE
    for clicks, peak in ((second, 0.7), (first, 0.3)):
        assert abs(host.click(0, clicks=clicks).peaks[0] - peak) < 0.01
        assert host.ask(commit) is Result.OK


def law_an_armed_device_plays_its_basis_until_the_next_is_whole(tier: Tier) -> None:
    host = with_basis(tier)
    # No larger than the first: between the commands there are 250 ms for its transfer on a slow line.
    other = Clicks(SAMPLE_RATE_HZ, [hump(0.2, 0.8, duration_us=2 * WAVEFORM_US)])
    *steps, commit = transfer_messages(other.basis.data)
    half = len(steps) // 2
    for message in steps[:half]:
        assert host.ask(message) is Result.OK
    assert abs(host.click(0, 0.5).peaks[0] - 0.5) < 0.01
    for message in (*steps[half:], commit, commit):
        assert host.ask(message) is Result.OK
    click = host.click(0, clicks=other)
    assert click.duration_us >= 2 * WAVEFORM_US
    assert np.abs(np.subtract(click.peaks[:2], (0.2, 0.8))).max() < 0.01


def law_a_basis_stays_unless_an_idle_device_needs_its_room_for_another(tier: Tier) -> None:
    host = with_basis(tier)
    assert host.hello is not None
    capacity = host.hello.basis_capacity_bytes
    assert host.ask(BasisBegin(5, 100)) is Result.OK
    assert host.ask(BasisCommit(5)) is Result.WRONG_HASH
    assert host.ask(BasisBegin(7, capacity)) is Result.NO_ROOM
    assert host.greet().held_basis_hash == CLICKS.basis.hash
    assert host.ask(BasisBegin(7, capacity)) is Result.OK
    assert host.greet().held_basis_hash == 0


def law_a_click_ends_by_itself(tier: Tier) -> None:
    host = with_basis(tier)
    click = host.click(0, 0.5)
    assert 0 <= click.duration_us - WAVEFORM_US <= tier.slack_us
    assert click.ended.trips == 0
    assert np.abs(np.subtract(click.peaks[:2], (0.5, 0.25))).max() < 0.01
    host.expect_silence(click.ended.device_time_us + tier.slack_us)


def law_a_click_that_the_basis_does_not_fit_is_refused(tier: Tier) -> None:
    host = with_basis(tier)
    before = host.fresh_status()
    missing = len(CLICKS.weights)
    fitting = CLICKS.play(0, 0)
    one_less = {"number_of_weights": 1, "weights": fitting.weights[:1]}
    # What stands behind the last set reads as one of no functions.
    none = {"basis_set": missing, "number_of_weights": 0, "weights": ()}
    changes: list[dict[str, Any]] = [{"fraction_bits": 0}, {"fraction_bits": 32}, one_less, none, {"basis_set": 255}]
    bad = [CLICKS.play(missing, 0), *(dataclasses.replace(fitting, **change) for change in changes)]
    frames = [host.frame(dataclasses.replace(play, clock_reference=host.clock_reference())) for play in bad]
    tier.write(b"".join(frames))
    refused = host.status(lambda status: status.refused == before.refused + 6)
    assert (refused.applied, refused.state) == (before.applied, DeviceState.ARMED)
    told = [m for m in host.heard if isinstance(m, Log) and m.code is LogCode.PLAY_REFUSED]
    # Others within the spacing are not told.
    assert [log.value for log in told] == [missing] or (tier.slack_us and told)


def law_a_long_click_needs_a_living_host(tier: Tier) -> None:
    clicks = Clicks(SAMPLE_RATE_HZ, [hump(1.0, 1.0, duration_us=400 * US_PER_MS)])
    for is_alive in (True, False):
        host = with_basis(tier, clicks.basis)
        started = host.play(0, clicks=clicks)
        for _ in range(30 * is_alive):
            host.send(KeepAlive(host.clock_reference(), started.applied_sequence))
            tier.wait(20 * US_PER_MS)
        ended = host.status(lambda status: status.state is not DeviceState.DRIVING)
        if is_alive:
            assert ended.device_time_us - started.applied_time_us >= 400 * US_PER_MS
        else:
            assert ended.state is DeviceState.LATCHED
            assert 0 <= ended.device_time_us - started.applied_time_us - DISARM_US <= tier.slack_us
            host.expect_silence(ended.device_time_us + RAMP_US + tier.slack_us)


def unchecked(functions: int) -> Basis:
    """A basis of one set of silent functions, however many."""
    basis = object.__new__(Basis)
    silence = BasisSet(np.zeros((functions, 2), np.int16), np.zeros(functions, np.uint8))
    object.__setattr__(basis, "sample_rate_hz", SAMPLE_RATE_HZ)
    object.__setattr__(basis, "sets", (silence,))
    return basis


def with_basis(tier: Tier, basis: Basis = CLICKS.basis, limit: int = FULL) -> Host:
    """Ready, with a basis."""
    host = Host(tier)
    assert Features.WAVEFORMS in host.greet().features
    assert host.offer(basis.data) is Result.OK
    assert host.arm(limit) is Result.OK
    return host


# ---- sample by sample --------------------------------------------------------------------------------------


def wave_law_takeovers_make_no_step(tier: WaveTier) -> None:
    host = with_basis(tier)
    drive, other = host.drive(*LOUD), host.drive(ChannelDrive(150, 0.7), ChannelDrive(180, 1.0))
    noise = np.random.default_rng(2)
    begun_us = host.device_us()
    for _ in range(40):
        match noise.integers(5):
            case 0:
                host.send(host.set_message(drive))
            case 1:
                host.send(host.set_message(other))
            case 2:
                host.send(host.set_message(bytes(len(drive))))
            case _:
                host.send(CLICKS.play(int(noise.integers(2)), host.clock_reference()))
        tier.wait(int(noise.integers(200, 20 * US_PER_MS)))
    host.pass_until(host.device_us() + 100 * US_PER_MS)
    rate_hz, displacements = tier.outputs(begun_us, host.device_us() - 50 * US_PER_MS)
    assert np.abs(displacements).max() > 0.5
    # A full sine of 200 Hz, the steepest waveform, and the slew of each that fades.
    fastest_per_s = math.tau * 200 + 2 * math.pi * US_PER_S / WAVEFORM_US + 3 * SLEW_PER_S
    assert np.abs(np.diff(displacements, axis=0)).max() <= fastest_per_s / rate_hz + ROUNDING


def wave_law_no_weights_pass_amplitude_or_slew_and_no_sum_the_limit(tier: WaveTier) -> None:
    noise = np.random.default_rng(3)
    functions = noise.integers(-32_767, 32_767, (24, 61), np.int16, endpoint=True)
    functions[:, [0, -1]] = 0
    basis = Basis(SAMPLE_RATE_HZ, (BasisSet(functions, noise.integers(0, 2, 24).astype(np.uint8)),))
    host = with_basis(tier, basis, limit=FULL // 2)
    assert host.hello is not None
    highest_hz = host.hello.frequency_maximum * host.hello.frequency_resolution_uhz * 1e-6

    def play(fraction_bits: int) -> None:
        weights = tuple(noise.integers(-32_768, 32_767, 24, endpoint=True).tolist())
        host.send(Play(host.clock_reference(), 0, fraction_bits, FULL, 24, weights))

    begun_us = host.device_us()
    for fraction_bits in (1, 12, 16, 19, 22):
        play(fraction_bits)
        host.status(lambda status: status.state is DeviceState.DRIVING)
        host.ended()
    tier.wait(US_PER_MS)
    clicked_us = host.device_us()
    for _ in range(10):
        host.set(host.drive(*LOUD))
        for wait_ms in (12, 5):
            tier.wait(wait_ms * US_PER_MS)
            play(19)
        tier.wait(15 * US_PER_MS)
    host.pass_until(host.device_us() + 100 * US_PER_MS)
    assert 0.49 < np.abs(tier.outputs(clicked_us, host.device_us())[1]).max() <= 0.5 + ROUNDING
    rate_hz, displacements = tier.outputs(begun_us, clicked_us)
    assert 0.49 < np.abs(displacements).max() <= 0.5 + ROUNDING
    # A change of one sample of the basis is a straight line, and rounded up to a step of it.
    fastest_per_s = 0.5 * math.tau * highest_hz + SAMPLE_RATE_HZ / 32_767
    assert np.abs(np.diff(displacements, axis=0)).max() <= fastest_per_s / rate_hz + ROUNDING
    assert not displacements[-1].any()


def wave_law_what_every_drive_leaves_quiet_stays_quiet_while_they_follow_each_other(tier: WaveTier) -> None:
    """Half of what the first actuator does and all of the second are 0 together, in every drive and in between."""
    host = Host(tier).ready()
    noise = np.random.default_rng(5)
    begun_us = 0
    for step in range(40):
        frequency_hz = noise.uniform(60, 300) if noise.integers(3) == 0 else 200
        amplitude, turned = noise.uniform(0.1, 1.0), noise.uniform(0, math.tau)
        drive = host.drive(
            ChannelDrive(frequency_hz, amplitude, turned), ChannelDrive(frequency_hz, amplitude / 2, turned + math.pi)
        )
        host.send(host.set_message(drive))
        # A crossfade of these takes up to twice the ramp: some wait for it, and some of those are overtaken.
        tier.wait(int(noise.integers(RAMP_US // 5, 3 * RAMP_US)))
        if step == 0:
            host.pass_until(host.device_us() + RAMP_US)
            begun_us = host.device_us()
    _, displacements = tier.outputs(begun_us, host.device_us())
    assert np.abs(displacements).max() > 0.5
    assert np.abs(displacements[:, :2] @ [0.5, 1.0]).max() <= ROUNDING


# ---- the host goes away ------------------------------------------------------------------------------------


def wave_law_a_dropped_line_latches_at_once(tier: WaveTier) -> None:
    host = Host(tier).ready()
    applied = host.set(host.drive(*LOUD))
    tier.hang_up()
    tier.wait(400 * US_PER_MS)
    again = Host(tier)
    again.compare_clocks()
    status = again.fresh_status()
    assert (status.state, status.fault) == (DeviceState.LATCHED, FaultCode.HUNG_UP)
    again.expect_silence(applied.applied_time_us + tier.lease_ms * US_PER_MS + RAMP_US + tier.slack_us)


def keep_laws(laws: Iterable[Callable[[T], None]], boot: Callable[[], T]) -> None:
    """Each law over a device that has just booted; a failure names its law."""
    for law in laws:
        try:
            law(boot())
        except AssertionError as error:
            error.add_note(f"law: {law.__name__}")
            raise


def _laws(prefix: str) -> Iterator[Callable[..., None]]:
    return (value for name, value in globals().items() if name.startswith(prefix))


LAWS: tuple[Law, ...] = tuple(_laws("law_"))
WAVE_LAWS: tuple[WaveLaw, ...] = tuple(_laws("wave_law_"))
