"""Every message of the wire, defined once: typed values to body bytes and back.

A body is `type u8, sequence u8, fields`, little-endian. The fields of a message are those of its class, in order; their
values are the integers that travel, so a round trip is exact. The one-line definition of a message is made from its
class, and its CRC-32 seeds the checksum of the frames: sides that define a message differently refuse each other's.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import KEEP, STRICT, IntEnum, IntFlag
from typing import Annotated

from firmware_link.protocol.layout import Counted, Layout, Message, PerActuator, Sender, Word

VERSION_MAJOR = 3  # another one is refused; a minor one adds optional messages (PROTOCOL.md)
VERSION_MINOR = 1
MAGIC = int.from_bytes(b"tact", "little")
MAXIMUM_ACTUATORS = 255

PM_PER_M = 1e12  # HELLO says full scales in picometres: a u32 of them reaches 4.3 mm
FULL_SCALE_WORD = 65_535  # the greatest u16
WORDS_PER_TURN = 65_536  # all of a u16, so that phases wrap as words do
CLOCK_REFERENCE_US = 100  # the step of the age of a command; a u16 of them wraps after 6.5 s
CLOCK_REFERENCE_SPAN = 65_536  # all of a u16
BASIS_CHUNK_SIZE = 192  # the frame has 204 bytes, below the 254 of one run of COBS
# As many as the count of a PLAY can say: clicks of 30 ms for eleven actuators.
MAXIMUM_WEIGHTS = 255
MAXIMUM_FRACTION_BITS = 31  # the greatest sum is then 127 of 32 767: finer weights would play next to nothing
# 32 samples of two actuators, 10 ms at 3.2 kHz: the frame is 211 bytes, and longer ones would save only 3 % of a line.
MAXIMUM_SENSED_VALUES = 96
LONGEST_SENSE_MS = 2_000  # a host that is gone leaves a line full this long; renewals come each 167 ms


class DeviceState(IntEnum):
    """What the firmware allows: only DRIVING has a drive, only a handshake leaves LATCHED."""

    IDLE = 0
    ARMED = 1
    DRIVING = 2
    LATCHED = 3


class Result(IntEnum):
    """The answer that an ACK carries."""

    OK = 0
    WRONG_BOOT = 1
    WRONG_STATE = 2
    OUT_OF_RANGE = 3
    NO_ROOM = 4
    WRONG_HASH = 5


class FaultCode(IntEnum):
    """Why the firmware disarmed itself."""

    NONE = 0
    SILENT_HOST = 1
    EMERGENCY_STOP = 2
    HUNG_UP = 3
    DRIVEN_TOO_LONG = 4


class Features(IntFlag, boundary=KEEP):
    """What a device can do beyond SET; a newer device may tell bits that this host does not know."""

    WAVEFORMS = 1
    HIGH_VOLTAGE_SENSE = 4


# No members of the class above: its members are in the definition of HELLO, which never changes.
ACCELEROMETER = Features(8)
LINEARISES = Features(16)


class LogLevel(IntEnum):
    """How much a LOG matters."""

    INFORMATION = 0
    WARNING = 1


class LogCode(IntEnum):
    """What a LOG says; LOG_TEXTS has the words, with {value} for its value."""

    BOOTED = 1
    LEASE_EXPIRED = 2
    PLAY_REFUSED = 3
    BASIS_TAKEN = 4


LOG_TEXTS = {
    LogCode.BOOTED: "first greeting since the device booted (reset cause {value})",
    LogCode.LEASE_EXPIRED: "the lease of drive {value} ended without a fresh frame",
    LogCode.PLAY_REFUSED: "a click does not fit set {value} of the basis that is held, or two clicks sound already",
    LogCode.BASIS_TAKEN: "the basis with hash {value:#010x} is held from now on",
}


class SetFlag(IntFlag, boundary=STRICT):
    """Flags of a SET."""

    WRITE_PHASE = 1


_U8 = Word("u8")
_U16 = Word("u16")
_U32 = Word("u32")
_U64 = Word("u64")
_AMPLITUDE = Word("u16", f"full scale/{FULL_SCALE_WORD}")
_CLOCK_REFERENCE = Word("u16", f"{CLOCK_REFERENCE_US} us")


@dataclass(frozen=True)
class HelloRequest(Message, wire_name="HELLO_REQ", type_byte=0x01, sender=Sender.HOST, has_fixed_seed=True):
    """Open a session; an armed device disarms, a latched one is released."""

    magic: Annotated[int, _U32]
    version_major: Annotated[int, _U8]
    version_minor: Annotated[int, _U8]
    nonce: Annotated[int, _U32]


@dataclass(frozen=True)
class Hello(Message, wire_name="HELLO", type_byte=0x02, sender=Sender.DEVICE, has_fixed_seed=True):
    """What the device is and can do; the only message that says its own number of actuators."""

    version_major: Annotated[int, _U8]
    version_minor: Annotated[int, _U8]
    nonce: Annotated[int, _U32]
    boot_id: Annotated[int, _U32]
    schema_hash: Annotated[int, _U32]
    features: Annotated[Features, _U32]
    firmware_major: Annotated[int, _U8]
    firmware_minor: Annotated[int, _U8]
    firmware_patch: Annotated[int, _U8]
    board: Annotated[int, _U16]
    synthesis_rate_hz: Annotated[int, _U32]
    frequency_resolution_uhz: Annotated[int, _U32]
    frequency_minimum: Annotated[int, Word("u16", "frequency resolution")]
    frequency_maximum: Annotated[int, Word("u16", "frequency resolution")]
    longest_lease_ms: Annotated[int, _U8]
    longest_waveform_ms: Annotated[int, _U16]
    basis_capacity_bytes: Annotated[int, _U32]
    held_basis_hash: Annotated[int, _U32]
    number_of_actuators: Annotated[int, _U8]
    full_scales_pm: Annotated[tuple[int, ...], PerActuator((("full_scale_pm", _U32),))]


@dataclass(frozen=True)
class Arm(Message, wire_name="ARM", type_byte=0x03, sender=Sender.HOST):
    """Allow drives within limits, for the named boot only."""

    boot_id: Annotated[int, _U32]
    slew_limit_per_s: Annotated[int, Word("u16", "full scale/s")]
    lease_ms: Annotated[int, _U8]
    longest_drive_s: Annotated[int, _U8]
    amplitude_limits: Annotated[tuple[int, ...], PerActuator((("amplitude_limit", _AMPLITUDE),))]


@dataclass(frozen=True)
class Ack(Message, wire_name="ACK", type_byte=0x04, sender=Sender.BOTH):
    """Answer to ARM, STOP, BASIS_* (device) or FAULT (host)."""

    acknowledged_type: Annotated[int, _U8]
    acknowledged_sequence: Annotated[int, _U8]
    result: Annotated[Result, _U8]


@dataclass(frozen=True)
class Set(Message, wire_name="SET", type_byte=0x05, sender=Sender.HOST):
    """Drive for one lease; no answer, the latest wins."""

    clock_reference: Annotated[int, _CLOCK_REFERENCE]
    flags: Annotated[SetFlag, _U8]
    lease_ms: Annotated[int, _U8]
    drive: Annotated[
        bytes,
        PerActuator(
            (
                ("frequency", Word("u16", "frequency resolution")),
                ("amplitude", _AMPLITUDE),
                ("phase", Word("u16", f"turn/{WORDS_PER_TURN}")),
            )
        ),
    ]


@dataclass(frozen=True)
class KeepAlive(Message, wire_name="KEEPALIVE", type_byte=0x06, sender=Sender.HOST):
    """The host is alive; renew the lease of the named SET if it was applied last; no answer.

    Another SET is not renewed, since the named one may not have arrived.
    """

    clock_reference: Annotated[int, _CLOCK_REFERENCE]
    applied_sequence: Annotated[int, _U8]


@dataclass(frozen=True)
class Stop(Message, wire_name="STOP", type_byte=0x07, sender=Sender.HOST, has_fixed_seed=True):
    """Ramp to zero and latch."""


@dataclass(frozen=True)
class TimeRequest(Message, wire_name="TIME_REQ", type_byte=0x08, sender=Sender.HOST):
    """Ask for the device's clock."""

    host_sent_ns: Annotated[int, _U64]


@dataclass(frozen=True)
class Time(Message, wire_name="TIME", type_byte=0x09, sender=Sender.DEVICE):
    """The request's own time, and the device's clock when the request came and when this left."""

    host_sent_ns: Annotated[int, _U64]
    device_received_us: Annotated[int, _U64]
    device_sent_us: Annotated[int, _U64]


@dataclass(frozen=True)
class Status(Message, wire_name="STATUS", type_byte=0x0A, sender=Sender.DEVICE):
    """State, the command applied last, and counters since boot; periodic, and on change."""

    state: Annotated[DeviceState, _U8]
    fault: Annotated[FaultCode, _U8]
    applied_sequence: Annotated[int, _U8]
    device_time_us: Annotated[int, _U64]
    applied_time_us: Annotated[int, _U64]
    high_voltage_dv: Annotated[int, Word("u16", "0.1 V")]
    applied: Annotated[int, _U32]
    ok: Annotated[int, _U32]
    crc: Annotated[int, _U32]
    framing: Annotated[int, _U32]
    length: Annotated[int, _U32]
    overrun: Annotated[int, _U32]
    stale: Annotated[int, _U32]
    refused: Annotated[int, _U32]
    trips: Annotated[int, _U32]


@dataclass(frozen=True)
class Fault(Message, wire_name="FAULT", type_byte=0x0B, sender=Sender.DEVICE):
    """The device disarmed itself; repeated until acknowledged."""

    fault: Annotated[FaultCode, _U8]
    device_time_us: Annotated[int, _U64]


@dataclass(frozen=True)
class Log(Message, wire_name="LOG", type_byte=0x0C, sender=Sender.DEVICE):
    """An event for people, as numbers; no answer."""

    level: Annotated[LogLevel, _U8]
    code: Annotated[LogCode, _U16]
    value: Annotated[int, _U32]
    device_time_us: Annotated[int, _U64]

    @property
    def text(self) -> str:
        """The event in words."""
        return LOG_TEXTS[self.code].format(value=self.value)


@dataclass(frozen=True)
class BasisBegin(Message, wire_name="BASIS_BEGIN", type_byte=0x0E, sender=Sender.HOST):
    """Begin to transfer a basis of clicks."""

    basis_hash: Annotated[int, _U32]
    size_bytes: Annotated[int, _U32]


@dataclass(frozen=True)
class BasisChunk(Message, wire_name="BASIS_CHUNK", type_byte=0x0F, sender=Sender.HOST):
    """The next bytes of the basis; the last chunk is filled up with zeros."""

    offset_bytes: Annotated[int, _U32]
    data: Annotated[bytes, Word(f"u8[{BASIS_CHUNK_SIZE}]")]


@dataclass(frozen=True)
class BasisCommit(Message, wire_name="BASIS_COMMIT", type_byte=0x10, sender=Sender.HOST):
    """Check the basis against its hash and hold it until the next one, or a reboot."""

    basis_hash: Annotated[int, _U32]


@dataclass(frozen=True)
class Play(Message, wire_name="PLAY", type_byte=0x11, sender=Sender.HOST):
    """Play a click, given as weights of a set of the basis, once; no answer, the latest SET or PLAY wins.

    `firmware_link.protocol.basis` says which waveform that is.
    """

    clock_reference: Annotated[int, _CLOCK_REFERENCE]
    basis_set: Annotated[int, _U8]
    fraction_bits: Annotated[int, _U8]
    amplitude: Annotated[int, _AMPLITUDE]
    number_of_weights: Annotated[int, _U8]
    weights: Annotated[tuple[int, ...], Counted((("weight", Word("i16", "2^-fraction_bits")),), MAXIMUM_WEIGHTS)]


@dataclass(frozen=True)
class Sense(Message, wire_name="SENSE", type_byte=0x12, sender=Sender.HOST, is_optional=True):
    """Send ACCELERATION for one lease, or with a lease of 0 no longer; answered by SENSOR."""

    lease_ms: Annotated[int, _U16]


@dataclass(frozen=True)
class Accelerometer(Message, wire_name="SENSOR", type_byte=0x13, sender=Sender.DEVICE, is_optional=True):
    """What the accelerometer is: nominal rate, scale of a count, greatest count, and samples that the device lost."""

    rate_mhz: Annotated[int, Word("u32", "mHz")]
    scale_nm_per_s2: Annotated[int, Word("u32", "nm/s^2")]
    greatest: Annotated[int, _U16]
    lost: Annotated[int, _U32]


@dataclass(frozen=True)
class Acceleration(Message, wire_name="ACCELERATION", type_byte=0x14, sender=Sender.DEVICE, is_optional=True):
    """Samples of the accelerometer, each followed by the displacement of every actuator at its instant.

    `frame` counts the frames, and `number` the samples of the accelerometer, both since boot. `number` and
    `synthesis_sample`, the sample of the synthesis that the actuators stood at, are those of the first sample here.
    """

    frame: Annotated[int, _U16]
    number: Annotated[int, _U32]
    synthesis_sample: Annotated[int, _U32]
    number_of_values: Annotated[int, _U8]
    values: Annotated[tuple[int, ...], Counted((("value", Word("i16")),), MAXIMUM_SENSED_VALUES)]


MESSAGES: tuple[type[Message], ...] = tuple(Message.__subclasses__())  # in the order of this file

_LAYOUTS = {message.type_byte: Layout(message) for message in MESSAGES}

# Without the optional messages: sides of which one does not know them understand each other in all others.
SCHEMA_HASH = zlib.crc32(
    "\n".join(layout.definition for layout in _LAYOUTS.values() if not layout.message.is_optional).encode("ascii")
)


def encode_body(message: Message, sequence: int) -> bytes:
    """Body bytes of a message; raises MessageError for a value that does not fit, never wraps it."""
    return _LAYOUTS[message.type_byte].encode(message, sequence)


_pack_set = _LAYOUTS[Set.type_byte].pack
_PLAY_HEAD = struct.Struct("<BBH")
_WRITES_PHASE = int(SetFlag.WRITE_PHASE)


def encode_set_body(
    clock_reference: int, lease_ms: int, drive: bytes, sequence: int, *, writes_phase: bool = True
) -> bytes:
    """Body of a SET, as `encode_body` makes it, but faster: the values of a link that is ready are known to fit."""
    return _pack_set(sequence, clock_reference, _WRITES_PHASE if writes_phase else 0, lease_ms) + drive


def encode_play(basis_set: int, fraction_bits: int, amplitude: int, weights: Sequence[int]) -> bytes:
    """What of a PLAY is known ahead of time: all of its body behind the clock reference. Raises MessageError."""
    return encode_body(Play(0, basis_set, fraction_bits, amplitude, len(weights), tuple(weights)), 0)[_PLAY_HEAD.size :]


def encode_play_body(clock_reference: int, play: bytes, sequence: int) -> bytes:
    """Body of a PLAY whose rest `encode_play` made, as `encode_set_body` otherwise."""
    return _PLAY_HEAD.pack(Play.type_byte, sequence, clock_reference) + play


def decode_body(body: bytes) -> tuple[int, Message]:
    """Sequence number and message of a body that `framing` accepted; raises MessageError for an unknown meaning."""
    return body[1], _LAYOUTS[body[0]].decode(body)


def seed_of(type_byte: int) -> int | None:
    """CRC seed of a message type; None for a type that does not exist."""
    layout = _LAYOUTS.get(type_byte)
    return None if layout is None else layout.seed


def has_exact_length(body: bytes, number_of_actuators: int) -> bool:
    """Whether a body of a known type is as long as that type demands.

    HELLO, PLAY and ACCELERATION say in the byte before what is repeated how often it is.
    """
    layout = _LAYOUTS[body[0]]
    fixed, repetitions = layout.length(0), number_of_actuators
    if len(body) >= fixed and (layout.most is not None or layout.message is Hello):
        repetitions = body[fixed - 1]
    return len(body) == layout.length(repetitions) and (layout.most is None or repetitions <= layout.most)


def longest_body_length(number_of_actuators: int) -> int:
    """Bytes of the longest body of any type for this number of actuators."""
    return max(layout.longest(number_of_actuators) for layout in _LAYOUTS.values())
