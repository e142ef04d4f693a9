"""What sounds on an emulated device: drives and waveforms that replace each other, and silence."""

from firmware_link.emulator.channels import Channels
from firmware_link.emulator.device_lease import Lease
from firmware_link.emulator.device_memory import Memory
from firmware_link.emulator.device_reports import Reports
from firmware_link.emulator.device_state import Device
from firmware_link.emulator.drive_log import Cause, DriveEvent, Outcome, PlayedWaveform
from firmware_link.protocol import messages
from firmware_link.protocol.basis import Basis, clamp_samples, sample_limits, weighted_sum
from firmware_link.protocol.player import Player

US_PER_MS = 1_000


class Drive:
    """SET, PLAY and KEEPALIVE: fresh ones hold a device that is armed. `log` has every change of what sounds."""

    def __init__(self, device: Device, lease: Lease, memory: Memory, reports: Reports) -> None:
        self.log: list[DriveEvent] = []
        self.channels = Channels(device.configuration)
        self.player = Player()
        self._device, self._lease, self._memory, self._reports = device, lease, memory, reports

    def set(self, message: messages.Set, sequence: int) -> Outcome:
        """Take the drive of a SET, if it is fresh."""
        outcome = self._check(message.clock_reference, sequence)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        now_us, lease = self._device.now_us, self._lease
        lease.refresh(sequence, now_us)
        lease.drive_us = min(message.lease_ms * US_PER_MS, lease.armed_us)
        lease.renewed_us = now_us
        writes_phase, takes_over = messages.SetFlag.WRITE_PHASE in message.flags, self.player.end_us is not None
        event = self.channels.apply(
            message.drive, writes_phase, now_us, sequence, takes_over=takes_over, is_first=not self.log
        )
        if event is not None:
            self.log.append(event)
        self._take_over()
        self._applied(
            sequence, messages.DeviceState.DRIVING if self.channels.is_driving else messages.DeviceState.ARMED
        )
        return outcome

    def play(self, message: messages.Play, sequence: int) -> Outcome:
        """Start the click of a PLAY, if it is fresh, fits the basis that is held, and has room."""
        outcome = self._check(message.clock_reference, sequence)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        now_us, basis = self._device.now_us, self._memory.basis
        if basis is None or not _fits(message, basis) or not self.player.has_room(now_us):
            self._reports.send_log(messages.LogLevel.WARNING, messages.LogCode.PLAY_REFUSED, message.basis_set)
            return Outcome.REFUSED
        self._lease.refresh(sequence, now_us)
        self.log.append(self.channels.play(self._waveform(message, basis), now_us, sequence))
        self._take_over()
        self.player.start(now_us, basis.length_us(message.basis_set), message.amplitude)
        self._applied(sequence, messages.DeviceState.DRIVING)
        return outcome

    def keep_alive(self, message: messages.KeepAlive, sequence: int) -> Outcome:
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

    def _waveform(self, message: messages.Play, basis: Basis) -> PlayedWaveform:
        configuration = self._device.configuration
        sums = weighted_sum(
            basis.sets[message.basis_set], message.weights, message.fraction_bits, configuration.number_of_actuators
        )
        highest_uhz = configuration.frequency_maximum * configuration.frequency_resolution_uhz
        samples = clamp_samples(sums, sample_limits(self.channels.take_limits(), highest_uhz, basis.sample_rate_hz))
        return PlayedWaveform.of(basis.sample_rate_hz, samples, message.amplitude / messages.FULL_SCALE_WORD)

    def _check(self, clock_reference: int, sequence: int) -> Outcome:
        """REFUSED where the device is not armed, STALE for an old frame or a copy."""
        if not self._device.is_armed:
            return Outcome.REFUSED
        is_fresh = self._lease.is_fresh(clock_reference, sequence, self._device.now_us)
        return Outcome.ACCEPTED if is_fresh else Outcome.STALE

    def _take_over(self) -> None:
        """Fade out the drive that played until now."""
        self.player.take_over(self._device.now_us, self.channels.slew_per_s)

    def _applied(self, sequence: int, state: messages.DeviceState) -> None:
        """A command was applied: STATUS tells of it soon."""
        device, reports = self._device, self._reports
        device.counters.applied += 1
        reports.applied_sequence, reports.applied_time_us = sequence, device.now_us
        device.want_status(max(device.now_us, reports.status_allowed_us))
        device.enter(state)


def _fits(message: messages.Play, basis: Basis) -> bool:
    """Whether the basis has the set of a PLAY, with as many functions as there are weights."""
    if message.basis_set >= len(basis.sets) or not 1 <= message.fraction_bits <= messages.MAXIMUM_FRACTION_BITS:
        return False
    return len(message.weights) == len(basis.sets[message.basis_set].actuators)
