"""State that the parts of an emulated device share: its configuration, its time, what it allows, and its counters."""

from dataclasses import dataclass, field

from firmware_link.host.link_values import BOARD_EMULATED
from firmware_link.protocol.messages import FULL_SCALE_WORD, MAXIMUM_SENSED_VALUES, DeviceState

LONGEST_LEASE_MS = 100  # TACTABLE_LONGEST_LEASE_MS of core/state.h: what a lost host leaves on (docs/safety.md)
FULL_SCALE_PM = 520_000  # 0.52 um, of the paper's actuators
BASIS_CAPACITY_BYTES = 1 << 18  # 256 KiB; that of two actuators and 30 ms has 10.7 kB (PROTOCOL.md)
LONGEST_WAVEFORM_MS = 1_000


@dataclass(frozen=True)
class DeviceConfiguration:
    """What the emulated board is; frequencies in steps of the resolution, slew in full scale a second.

    Its fields but `full_scales_pm` are the options of host/host.h, in this order.

    Without `full_scales_pm` each is FULL_SCALE_PM. A `basis_capacity_bytes` of 0 is a device without waveforms, a
    `longest_drive_s` of 0 one without its own limit, a `sensor_rate_mhz` of 0 one without an accelerometer, an
    `electrode_bias` of 0 one that does not linearise.
    """

    boot_id: int
    number_of_actuators: int = 2
    longest_lease_ms: int = LONGEST_LEASE_MS
    frequency_resolution_uhz: int = 10_000
    frequency_minimum: int = 100
    frequency_maximum: int = FULL_SCALE_WORD
    amplitude_limit: int = FULL_SCALE_WORD
    slew_limit_per_s: int = 1_000
    full_scales_pm: tuple[int, ...] = ()
    synthesis_rate_hz: int = 48_000
    basis_capacity_bytes: int = BASIS_CAPACITY_BYTES
    longest_waveform_ms: int = LONGEST_WAVEFORM_MS
    longest_drive_s: int = 0
    board: int = BOARD_EMULATED
    sensor_rate_mhz: int = 0
    sensor_scale_nm_per_s2: int = 0
    sensor_greatest: int = 0
    electrode_bias: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.longest_lease_ms <= LONGEST_LEASE_MS:
            raise ValueError(f"longest_lease_ms is {self.longest_lease_ms}; expected 1 to {LONGEST_LEASE_MS}")
        if not 1 <= self.number_of_actuators <= 255:
            raise ValueError(f"number_of_actuators is {self.number_of_actuators}; expected 1 to 255")
        if len(self.full_scales_pm) not in (0, self.number_of_actuators):
            raise ValueError(f"{len(self.full_scales_pm)} full scales for {self.number_of_actuators} actuators")
        if self.sensor_rate_mhz and self.number_of_actuators >= MAXIMUM_SENSED_VALUES:
            raise ValueError(f"{self.number_of_actuators} actuators have no room in a frame of the accelerometer")


@dataclass
class DeviceCounters:
    """What the firmware counted since boot, beside its framing counters; `applied` are SET and PLAY."""

    applied: int = 0
    stale: int = 0
    refused: int = 0
    trips: int = 0


@dataclass
class Device:
    """The data of one device since it booted; `tactable_device` in firmware/core/state.h."""

    configuration: DeviceConfiguration
    now_us: int = 0
    state: DeviceState = DeviceState.IDLE
    counters: DeviceCounters = field(default_factory=DeviceCounters)
    status_due_us: int | None = None  # when the next status is to be sent; None until the first greeting
    driving_since_us: int = 0
    longest_drive_us: int | None = None  # how long a drive may last; None where there is no limit

    @property
    def is_armed(self) -> bool:
        """Whether drives are allowed."""
        return self.state in (DeviceState.ARMED, DeviceState.DRIVING)

    def enter(self, state: DeviceState) -> None:
        """Change the state; STATUS says so at once."""
        if state is not self.state:
            self.state = state
            self.driving_since_us = self.now_us
            self.want_status(self.now_us)

    def want_status(self, due_us: int) -> None:
        """STATUS is due no later than this."""
        self.status_due_us = due_us if self.status_due_us is None else min(self.status_due_us, due_us)
