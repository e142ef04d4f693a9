"""Values of a link: its configuration, the capabilities of the device, events and counters."""

from dataclasses import dataclass
from enum import Enum

from firmware_link import BIT_RATE_HZ
from firmware_link.protocol import drive_words, messages
from firmware_link.protocol.basis import Basis

BOARD_EMULATED, BOARD_SOUND_CARD = 0, 6  # numbers of the boards that are no boards, in HELLO
_NO_FEATURES = messages.Features(0)


class LinkState(Enum):
    """State of the session; drives are sent in READY only."""

    DISCONNECTED = "disconnected"
    GREETING = "greeting"
    PREPARING = "preparing"
    SYNCHRONISING = "synchronising"
    ARMING = "arming"
    READY = "ready"
    STOPPING = "stopping"
    STOPPED = "stopped"


@dataclass(frozen=True)
class LinkConfiguration:
    """Configuration that the host asks of the device.

    Amplitude limits are fractions of full scale, one an actuator, None for no limit; slew is full scale a second. A
    drive without a pause ends after `longest_drive_s`, 0 is no limit. `basis` is that of the clicks of `set_play`; its
    functions move the first actuators of the device.

    The bit rate paces what is sent. Opening a port resets many boards, and some wait seconds in their boot loader:
    hence the patience of the handshake.
    """

    number_of_actuators: int
    amplitude_limits: tuple[float, ...] | None = None
    slew_limit_per_s: int = 200
    lease_ms: int = 40
    bit_rate_hz: int = BIT_RATE_HZ
    handshake_timeout_s: float = 5.0
    longest_drive_s: int = 0
    basis: Basis | None = None

    def __post_init__(self) -> None:
        if self.amplitude_limits is not None and len(self.amplitude_limits) != self.number_of_actuators:
            given = len(self.amplitude_limits)
            raise ValueError(f"{given} amplitude limits for {self.number_of_actuators} actuators")
        self.arm_for(0, self.number_of_actuators, self.lease_ms)

    def arm_for(self, boot_id: int, number_of_actuators: int, lease_ms: int) -> messages.Arm:
        """The ARM for a device; its actuators beyond the configured ones may not move. Raises MessageError."""
        limits = self.amplitude_limits or (1.0,) * self.number_of_actuators
        words = [*map(drive_words.encode_amplitude, limits), *[0] * (number_of_actuators - len(limits))]
        return messages.Arm(boot_id, self.slew_limit_per_s, lease_ms, self.longest_drive_s, tuple(words))


@dataclass(frozen=True)
class Capabilities:
    """What the device said of itself, in SI units; full scales are base displacements, one an actuator."""

    number_of_actuators: int
    frequency_resolution_hz: float
    frequency_minimum_hz: float
    frequency_maximum_hz: float
    full_scales_m: tuple[float, ...]
    longest_lease_ms: int
    synthesis_rate_hz: int
    boot_id: int
    board: int
    features: messages.Features = _NO_FEATURES
    longest_waveform_ms: int = 0
    basis_capacity_bytes: int = 0
    held_basis_hash: int = 0

    @classmethod
    def from_hello(cls, hello: messages.Hello) -> "Capabilities":
        """The capabilities of a greeting."""
        resolution_hz = hello.frequency_resolution_uhz * 1e-6
        return cls(
            number_of_actuators=hello.number_of_actuators,
            frequency_resolution_hz=resolution_hz,
            frequency_minimum_hz=hello.frequency_minimum * resolution_hz,
            frequency_maximum_hz=hello.frequency_maximum * resolution_hz,
            full_scales_m=tuple(full_scale_pm * 1e-12 for full_scale_pm in hello.full_scales_pm),
            longest_lease_ms=hello.longest_lease_ms,
            synthesis_rate_hz=hello.synthesis_rate_hz,
            boot_id=hello.boot_id,
            board=hello.board,
            features=hello.features,
            longest_waveform_ms=hello.longest_waveform_ms,
            basis_capacity_bytes=hello.basis_capacity_bytes,
            held_basis_hash=hello.held_basis_hash,
        )


@dataclass(frozen=True)
class Greeted:
    """The device answered and fits."""

    capabilities: Capabilities


@dataclass(frozen=True)
class Armed:
    """The device takes drives from now on."""


@dataclass(frozen=True)
class BasisReplaced:
    """The device plays the basis of `Link.replace_basis` from now on."""


@dataclass(frozen=True)
class BasisRefused:
    """The device keeps the basis that it had."""

    result: messages.Result


@dataclass(frozen=True)
class AccelerometerDescribed:
    """The device said what its accelerometer is: nominal rate, m/s^2 of a count, and the count where it clips.

    lost: samples since the device booted that it had no room for, or did not read in time.
    """

    rate_hz: float
    scale_m_per_s2: float
    greatest: int
    lost: int


@dataclass(frozen=True)
class Stopped:
    """The device acknowledged STOP."""


Event = (
    Greeted
    | Armed
    | messages.Status
    | messages.Fault
    | messages.Log
    | BasisReplaced
    | BasisRefused
    | AccelerometerDescribed
    | messages.Acceleration
    | Stopped
)
"""A Fault, or a Status that is not armed, ends a session that is READY: the device latched, or was rebooted."""


@dataclass
class LinkCounters:
    """Commands sent, renewed, kept alive, replaced before they were sent, or dropped; then what the device said."""

    sent: int = 0
    renewed: int = 0
    kept_alive: int = 0
    coalesced: int = 0
    dropped: int = 0
    acknowledged: int = 0
    refused: int = 0
    statuses: int = 0
    faults: int = 0
    logs: int = 0
    unexpected: int = 0
