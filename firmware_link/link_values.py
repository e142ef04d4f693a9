"""What a link is told and what it tells: configuration, capabilities, events and counters."""

from dataclasses import dataclass
from enum import Enum

from firmware_link.messages import FaultCode, Hello, Status


class LinkState(Enum):
    """Where the session is; drives are sent in READY only."""

    DISCONNECTED = "disconnected"
    GREETING = "greeting"
    SYNCHRONISING = "synchronising"
    ARMING = "arming"
    READY = "ready"
    STOPPING = "stopping"
    STOPPED = "stopped"


@dataclass(frozen=True)
class LinkConfiguration:
    """What the host wants of the device.

    Amplitude limits are fractions of full scale, one an actuator, None for no limit; slew is full scale a second. The
    bit rate paces what is sent; a USB port that ignores its bit rate may be given the rate it really has. Opening a
    port resets many boards, and some wait seconds in their boot loader: hence the patience of the handshake.
    """

    number_of_actuators: int
    amplitude_limits: tuple[float, ...] | None = None
    slew_limit_per_s: int = 200
    lease_ms: int = 40
    bit_rate_hz: int = 115_200
    handshake_timeout_s: float = 5.0

    def __post_init__(self) -> None:
        if self.amplitude_limits is not None and len(self.amplitude_limits) != self.number_of_actuators:
            given = len(self.amplitude_limits)
            raise ValueError(f"{given} amplitude limits for {self.number_of_actuators} actuators")


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
    firmware_version: tuple[int, int, int]

    @classmethod
    def from_hello(cls, hello: Hello) -> "Capabilities":
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
            firmware_version=(hello.firmware_major, hello.firmware_minor, hello.firmware_patch),
        )


@dataclass(frozen=True)
class Greeted:
    """The device answered and fits."""

    capabilities: Capabilities


@dataclass(frozen=True)
class Armed:
    """The device takes drives from now on."""


@dataclass(frozen=True)
class StatusReceived:
    """The device's state and counters; in READY, one that is not armed ends the session: it was rebooted or latched."""

    status: Status
    host_received_ns: int


@dataclass(frozen=True)
class FaultReceived:
    """The device disarmed itself; the link acknowledges, and stays STOPPED until `connect`."""

    fault: FaultCode
    device_time_us: int


@dataclass(frozen=True)
class Stopped:
    """The device acknowledged STOP."""


Event = Greeted | Armed | StatusReceived | FaultReceived | Stopped


@dataclass
class LinkCounters:
    """What the link did: drives sent, sent again, replaced unsent or not taken; then what the device said."""

    sent: int = 0
    renewed: int = 0
    coalesced: int = 0
    dropped: int = 0
    acknowledged: int = 0
    refused: int = 0
    statuses: int = 0
    faults: int = 0
    unexpected: int = 0
