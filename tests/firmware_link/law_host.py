"""A host that speaks to any device frame by frame, as the laws of the conformance suite want it, and what it plays."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from base.arrays import Array
from firmware_link.protocol.basis import (
    SAMPLE_FULL_SCALE,
    Basis,
    BasisSet,
    EncodedClick,
    encode_click,
    transfer_messages,
)
from firmware_link.protocol.drive_words import ChannelDrive, encode_amplitude, encode_drive
from firmware_link.protocol.framing import FrameDecoder, encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import (
    CLOCK_REFERENCE_SPAN,
    CLOCK_REFERENCE_US,
    FULL_SCALE_WORD,
    MAGIC,
    VERSION_MAJOR,
    VERSION_MINOR,
    Ack,
    Arm,
    DeviceState,
    Features,
    Hello,
    HelloRequest,
    Play,
    Result,
    Set,
    SetFlag,
    Status,
    Time,
    TimeRequest,
    decode_body,
)

FRACTION_BITS = 14


class Clicks:
    """Waveforms (sample, actuator) in fractions of full scale, by index, and the basis of which they are."""

    def __init__(self, sample_rate_hz: int, waveforms: Sequence[Array]) -> None:
        peaks = [np.abs(waveform).max(axis=0) for waveform in waveforms]
        self.weights = [tuple(np.rint(peak * 2**FRACTION_BITS).astype(int).tolist()) for peak in peaks]
        self.basis = Basis(
            sample_rate_hz,
            tuple(
                BasisSet(
                    np.rint(SAMPLE_FULL_SCALE * waveform.T / np.maximum(peak, 1e-9)[:, None]).astype(np.int16),
                    np.arange(len(peak), dtype=np.uint8),
                )
                for waveform, peak in zip(waveforms, peaks, strict=True)
            ),
        )

    def play(self, index: int, clock_reference: int, amplitude: int = FULL_SCALE_WORD) -> Play:
        """The PLAY of one of them; one beyond the last is that of a set that is not there."""
        weights = self.weights[min(index, len(self.weights) - 1)]
        return Play(clock_reference, index, FRACTION_BITS, amplitude, len(weights), weights)

    def encoded(self, index: int, amplitude: float = 1.0) -> EncodedClick:
        """One of them as a link takes it."""
        return encode_click(self.basis, index, self.weights[index], FRACTION_BITS, amplitude)


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


def with_basis(tier: Tier, basis: Basis = CLICKS.basis, limit: int = FULL) -> Host:
    host = Host(tier)
    assert Features.WAVEFORMS in host.greet().features
    assert host.offer(basis.data) is Result.OK
    assert host.arm(limit) is Result.OK
    return host
