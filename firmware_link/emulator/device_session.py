"""Who may drive an emulated device: greeting, arming, latching, and the way of each message to its handler."""

from firmware_link.emulator.device_lease import Lease
from firmware_link.emulator.device_memory import Memory
from firmware_link.emulator.device_reports import Reports
from firmware_link.emulator.device_state import Device
from firmware_link.emulator.drive_log import Cause, Outcome, ReceivedFrame
from firmware_link.emulator.sense import Accelerations
from firmware_link.emulator.sounding import Drive
from firmware_link.protocol import messages
from firmware_link.protocol.layout import Message
from firmware_link.protocol.link_errors import MessageError

US_PER_MS = 1_000
US_PER_S = 1_000_000


class Session:
    """The states IDLE, ARMED, DRIVING and LATCHED; `received` has every frame with a valid checksum."""

    def __init__(
        self, device: Device, lease: Lease, drive: Drive, memory: Memory, sense: Accelerations, reports: Reports
    ) -> None:
        self.received: list[ReceivedFrame] = []
        self._device, self._lease, self._drive, self._memory, self._reports = device, lease, drive, memory, reports
        self._sense = sense

    def act_on(self, body: bytes) -> None:
        """Act on a body that the framing accepted, and count the outcome."""
        counters = self._device.counters
        try:
            sequence, message = messages.decode_body(body)
        except MessageError:
            counters.refused += 1
            return
        outcome = self._dispatch(message, sequence)
        counters.stale += outcome is Outcome.STALE
        counters.refused += outcome is Outcome.REFUSED
        self.received.append(ReceivedFrame(self._device.now_us, message.wire_name, sequence, outcome))

    def silence(self, state: messages.DeviceState, cause: Cause) -> None:
        """Silence, in a new state."""
        self._drive.silence(cause)
        self._device.enter(state)

    def latch(self, fault: messages.FaultCode, cause: Cause) -> None:
        """Silence, and nothing more without a new handshake."""
        self.silence(messages.DeviceState.LATCHED, cause)
        self._reports.raise_fault(fault)

    def _dispatch(self, message: Message, sequence: int) -> Outcome:
        match message:
            case messages.Set():
                return self._drive.set(message, sequence)
            case messages.Play():
                return self._drive.play(message, sequence)
            case messages.KeepAlive():
                return self._drive.keep_alive(message, sequence)
            case messages.HelloRequest():
                return self._greet(message)
            case messages.Arm():
                return self._acknowledge(message, sequence, self._arm(message, sequence))
            case messages.Stop():
                self.silence(messages.DeviceState.LATCHED, Cause.STOP)
                return self._acknowledge(message, sequence, messages.Result.OK)
            case messages.TimeRequest():
                self._reports.send_time(message.host_sent_ns)
                return Outcome.ACCEPTED
            case messages.BasisBegin() | messages.BasisChunk() | messages.BasisCommit():
                return self._memory.keep(message, sequence)
            case messages.Sense():
                return self._sense.ask_for_stream(message)
            case messages.Ack() if self._reports.settle_fault(message):
                return Outcome.ACCEPTED
        return Outcome.REFUSED

    def _greet(self, request: messages.HelloRequest) -> Outcome:
        if request.magic != messages.MAGIC:
            return Outcome.REFUSED
        device, reports, memory = self._device, self._reports, self._memory
        self.silence(messages.DeviceState.IDLE, Cause.NEW_SESSION)
        memory.end_transfer()
        self._sense.cut()
        reports.send_hello(request.nonce, memory.held_hash)
        if not reports.was_greeted:
            reports.was_greeted = True
            reports.send_log(messages.LogLevel.INFORMATION, messages.LogCode.BOOTED, 0)
        device.want_status(device.now_us)
        return Outcome.ACCEPTED

    def _arm(self, arm: messages.Arm, sequence: int) -> messages.Result:
        device, configuration = self._device, self._device.configuration
        if arm.boot_id != configuration.boot_id:
            return messages.Result.WRONG_BOOT
        if device.state not in (messages.DeviceState.IDLE, messages.DeviceState.ARMED):
            return messages.Result.WRONG_STATE
        if not (arm.slew_limit_per_s and 1 <= arm.lease_ms <= configuration.longest_lease_ms):
            return messages.Result.OUT_OF_RANGE
        limits = tuple(min(limit, configuration.amplitude_limit) for limit in arm.amplitude_limits)
        self._drive.channels.limit(limits, min(arm.slew_limit_per_s, configuration.slew_limit_per_s))
        self._lease.armed_us = arm.lease_ms * US_PER_MS
        # Of two limits in seconds the shorter one holds; 0 is no limit.
        on_times_s = [limit_s for limit_s in (arm.longest_drive_s, configuration.longest_drive_s) if limit_s]
        device.longest_drive_us = min(on_times_s) * US_PER_S if on_times_s else None
        self._lease.refresh(sequence, device.now_us)
        device.enter(messages.DeviceState.ARMED)
        return messages.Result.OK

    def _acknowledge(self, message: Message, sequence: int, result: messages.Result) -> Outcome:
        self._reports.send_ack(message.type_byte, sequence, result)
        return Outcome.ACCEPTED if result is messages.Result.OK else Outcome.REFUSED
