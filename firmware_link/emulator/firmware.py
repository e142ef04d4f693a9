"""Emulated firmware with virtual time: bytes and time in, bytes and a log of drives out.

It is the reference for the firmware in C, written a second time in another language: each module has a twin of the
same name in `firmware/core` (this one is `device`), tests run one set of laws over both and compare their outputs.

    firmware → session → drive → memory → sense → reports → lease, state     each imports only what stands to its right

States: IDLE (greeted or not, nothing moves) → ARMED (drives are allowed) ⇄ DRIVING (one sounds) → LATCHED (nothing
moves until a new handshake). The device leaves DRIVING by itself when a waveform or a lease ends, and latches by itself
when a drive lasts too long, the host is silent, the line hangs up or an emergency stop comes.
"""

from collections.abc import Sequence

from firmware_link.emulator.device_lease import Lease
from firmware_link.emulator.device_memory import Memory
from firmware_link.emulator.device_reports import Reports
from firmware_link.emulator.device_session import Session
from firmware_link.emulator.device_state import Device, DeviceConfiguration
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.sense import Accelerations
from firmware_link.emulator.sounding import Drive
from firmware_link.protocol.framing import FrameDecoder, Signal
from firmware_link.protocol.messages import DeviceState, FaultCode, LogCode, LogLevel


class EmulatedFirmware:
    """The reference firmware with virtual time: the caller owns the clock, which must not run backwards."""

    def __init__(self, configuration: DeviceConfiguration) -> None:
        self.configuration = configuration
        self._decoder = FrameDecoder(configuration.number_of_actuators)
        self._device = Device(configuration)
        self._lease = Lease()
        self._reports = Reports(self._device, self._decoder.counters)
        self._memory = Memory(self._device, self._reports)
        self._drive = Drive(self._device, self._lease, self._memory, self._reports)
        self._sense = Accelerations(self._device, self._reports)
        self._session = Session(self._device, self._lease, self._drive, self._memory, self._sense, self._reports)
        self.counters = self._device.counters  # counters of the firmware since boot, without those of frames
        self.framing_counters = self._decoder.counters  # frames accepted and refused since boot
        self.drive_log = self._drive.log  # every change of what sounds; it grows
        self.received = self._session.received  # every frame with a valid checksum; it grows

    @property
    def state(self) -> DeviceState:
        """State of the firmware: what it allows."""
        return self._device.state

    @property
    def senses(self) -> bool:
        """Whether samples of the accelerometer are wanted."""
        return self._sense.end_us is not None

    def sense(self, acceleration: int, displacements: Sequence[int], synthesis_sample: int) -> None:
        """Take a sample of the accelerometer in counts, with the displacements (full scale/32767) of its instant."""
        self._sense.take_sample(acceleration, displacements, synthesis_sample)

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that came at `now_us`; returns what the device sends until then."""
        self._advance(now_us)
        for item in self._decoder.receive(data):
            if isinstance(item, Signal):
                self._session.latch(FaultCode.EMERGENCY_STOP, Cause.EMERGENCY_STOP)
            else:
                self._session.act_on(item)
        return self.run_until(now_us)

    def run_until(self, now_us: int) -> bytes:
        """Let time pass up to `now_us`; returns what the device sends until then."""
        self._advance(now_us)
        return self._reports.take_outgoing()

    def hang_up(self, now_us: int) -> bytes:
        """The host let go of the line, or pulled it; returns what the device sends until then."""
        self._advance(now_us)
        self._sense.cut()
        if self._device.is_armed:
            self._session.latch(FaultCode.HUNG_UP, Cause.HUNG_UP)
        return self.run_until(now_us)

    def next_deadline_us(self) -> int | None:
        """Time at which the device acts by itself next; None while it waits for a host."""
        deadlines = (
            self._drive.player.end_us,
            self._drive_end_us(),
            self._on_time_end_us(),
            self._watchdog_end_us(),
            self._reports.fault_due_us,
            self._device.status_due_us,
            self._sense.end_us,
        )
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def _advance(self, now_us: int) -> None:
        device = self._device
        while (deadline_us := self.next_deadline_us()) is not None and deadline_us <= now_us:
            device.now_us = max(deadline_us, device.now_us)
            self._act_on_deadlines()
        device.now_us = now_us
        self._sense.send()

    def _act_on_deadlines(self) -> None:
        """Do what is due; the order is the protocol's: what comes later sees what came before."""
        device, session = self._device, self._session
        if self._is_due(self._drive.player.end_us):
            self._drive.player.finish()
            device.enter(DeviceState.ARMED)
        if self._is_due(self._drive_end_us()):
            device.counters.trips += 1
            session.silence(DeviceState.ARMED, Cause.LEASE_EXPIRED)
            self._reports.send_log(LogLevel.WARNING, LogCode.LEASE_EXPIRED, self._reports.applied_sequence)
        if self._is_due(self._on_time_end_us()):
            session.latch(FaultCode.DRIVEN_TOO_LONG, Cause.DRIVEN_TOO_LONG)
        if self._is_due(self._watchdog_end_us()):
            session.latch(FaultCode.SILENT_HOST, Cause.SILENT_HOST)
        self._reports.send_due()
        if self._is_due(self._sense.end_us):
            self._sense.end()

    def _drive_end_us(self) -> int | None:
        return self._lease.end_us if self._drive.channels.is_driving else None

    def _on_time_end_us(self) -> int | None:
        device = self._device
        if device.longest_drive_us is None or device.state is not DeviceState.DRIVING:
            return None
        return device.driving_since_us + device.longest_drive_us

    def _watchdog_end_us(self) -> int | None:
        return self._lease.watchdog_end_us if self._device.is_armed else None

    def _is_due(self, deadline_us: int | None) -> bool:
        return deadline_us is not None and deadline_us <= self._device.now_us
