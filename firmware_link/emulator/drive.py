"""What sounds on an emulated device: drives and waveforms that replace each other, and silence."""

from firmware_link.emulator.channels import Channels
from firmware_link.emulator.drive_log import Cause, DriveEvent, Outcome, PlayedWaveform
from firmware_link.emulator.lease import Lease
from firmware_link.emulator.memory import Memory
from firmware_link.emulator.reports import Reports
from firmware_link.emulator.state import Device
from firmware_link.protocol.messages import (
    FULL_SCALE_WORD,
    DeviceState,
    KeepAlive,
    LogCode,
    LogLevel,
    Play,
    Set,
    SetFlag,
)
from firmware_link.protocol.player import Player

US_PER_MS = 1_000


class Drive:
    """SET, PLAY and KEEPALIVE: fresh ones hold a device that is armed. `log` has every change of what sounds."""

    def __init__(self, device: Device, lease: Lease, memory: Memory, reports: Reports) -> None:
        configuration = device.configuration
        self.log: list[DriveEvent] = []
        self.channels = Channels(
            configuration.number_of_actuators,
            configuration.frequency_resolution_uhz * 1e-6,
            configuration.frequency_minimum,
            configuration.frequency_maximum,
        )
        self.player = Player()
        self._device, self._lease, self._memory, self._reports = device, lease, memory, reports

    def set(self, message: Set, sequence: int) -> Outcome:
        """Take the drive of a SET, if it is fresh."""
        outcome = self._check(message.clock_reference, sequence)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        now_us, lease = self._device.now_us, self._lease
        lease.refresh(sequence, now_us)
        lease.drive_us = min(message.lease_ms * US_PER_MS, lease.armed_us)
        lease.renewed_us = now_us
        event = self.channels.apply(
            message.drive,
            SetFlag.WRITE_PHASE in message.flags,
            now_us,
            sequence,
            takes_over=self.player.end_us is not None,
        )
        if event is not None:
            self.log.append(event)
        self._take_over()
        self._applied(sequence, DeviceState.DRIVING if self.channels.is_driving else DeviceState.ARMED)
        return outcome

    def play(self, message: Play, sequence: int) -> Outcome:
        """Start the waveform of a PLAY, if it is fresh, held and has room."""
        outcome = self._check(message.clock_reference, sequence)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        now_us, store = self._device.now_us, self._memory.store
        bank = store.bank
        if bank is None or message.waveform >= len(bank.waveforms) or not self.player.has_room(now_us):
            self._reports.send_log(LogLevel.WARNING, LogCode.PLAY_REFUSED, message.waveform)
            return Outcome.REFUSED
        self._lease.refresh(sequence, now_us)
        waveform = PlayedWaveform(store.held_hash, message.waveform, message.amplitude / FULL_SCALE_WORD)
        self.log.append(self.channels.play(waveform, now_us, sequence))
        self._take_over()
        self.player.start(now_us, bank.length_us(message.waveform), message.amplitude)
        self._applied(sequence, DeviceState.DRIVING)
        return outcome

    def keep_alive(self, message: KeepAlive, sequence: int) -> Outcome:
        """Feed the watchdog and, where the frame names the command that was applied last, renew its lease."""
        outcome = self._check(message.clock_reference, sequence)
        if outcome is Outcome.ACCEPTED:
            self._lease.refresh(sequence, self._device.now_us)
            if message.applied_sequence == self._reports.applied_sequence:
                self._lease.renewed_us = self._device.now_us
        return outcome

    def silence(self, cause: Cause) -> None:
        """Ramp every amplitude to zero."""
        if self.channels.is_driving or self.player.end_us is not None:
            self.log.append(self.channels.silence(self._device.now_us, cause))
            self._take_over()

    def _check(self, clock_reference: int, sequence: int) -> Outcome:
        """REFUSED where the device is not armed, STALE for an old frame or a copy."""
        if not self._device.is_armed:
            return Outcome.REFUSED
        is_fresh = self._lease.is_fresh(clock_reference, sequence, self._device.now_us)
        return Outcome.ACCEPTED if is_fresh else Outcome.STALE

    def _take_over(self) -> None:
        """What played goes on only to fade."""
        self.player.take_over(self._device.now_us, self.channels.slew_per_s)

    def _applied(self, sequence: int, state: DeviceState) -> None:
        """A command was applied: STATUS tells of it soon."""
        device, reports = self._device, self._reports
        device.counters.applied += 1
        reports.applied_sequence, reports.applied_time_us = sequence, device.now_us
        device.want_status(max(device.now_us, reports.status_allowed_us))
        device.enter(state)
