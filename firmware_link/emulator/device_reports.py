"""What an emulated device says: answers at once, STATUS and FAULT when they are due, LOG not too often."""

from dataclasses import asdict

from firmware_link.emulator.device_state import FULL_SCALE_PM, Device
from firmware_link.protocol import messages
from firmware_link.protocol.framing import FrameEncoder, FramingCounters, encode_message
from firmware_link.protocol.layout import Message

STATUS_PERIOD_US = 100_000  # 65 bytes each: 6 % of 115 200 bit/s
STATUS_SPACING_US = 10_000  # a new drive is reported this soon; more often would crowd a slow line
FAULT_PERIOD_US = 100_000  # PROTOCOL.md; with STATUS, which says it too
LOG_SPACING_US = 10_000  # PROTOCOL.md: logs must not crowd a slow line


class Reports:
    """The frames on their way to the host, and when the next periodic ones are due."""

    def __init__(self, device: Device, framing_counters: FramingCounters) -> None:
        self.applied_sequence = 0
        self.applied_time_us = 0
        self.was_greeted = False
        self.fault_due_us: int | None = None  # the fault that waits for its ACK, or None
        self.status_allowed_us = 0
        self._log_allowed_us = 0
        self._device, self._framing_counters = device, framing_counters
        self._encoder = FrameEncoder()
        self._outgoing: list[bytes] = []
        self._fault, self._fault_sequence, self._fault_time_us = messages.FaultCode.NONE, 0, 0

    def take_outgoing(self) -> bytes:
        """Everything said since the last call."""
        outgoing, self._outgoing = b"".join(self._outgoing), []
        return outgoing

    def send_hello(self, nonce: int, held_basis_hash: int) -> None:
        """Say what the device is and can do."""
        configuration = self._device.configuration
        self.send(
            messages.Hello(
                version_major=messages.VERSION_MAJOR,
                version_minor=messages.VERSION_MINOR,
                nonce=nonce,
                boot_id=configuration.boot_id,
                schema_hash=messages.SCHEMA_HASH,
                features=(messages.Features.WAVEFORMS if configuration.basis_capacity_bytes else messages.Features(0))
                | (messages.ACCELEROMETER if configuration.sensor_rate_mhz else messages.Features(0))
                | (messages.LINEARISES if configuration.electrode_bias else messages.Features(0)),
                firmware_major=0,
                firmware_minor=2,
                firmware_patch=0,
                board=configuration.board,
                synthesis_rate_hz=configuration.synthesis_rate_hz,
                frequency_resolution_uhz=configuration.frequency_resolution_uhz,
                frequency_minimum=configuration.frequency_minimum,
                frequency_maximum=configuration.frequency_maximum,
                longest_lease_ms=configuration.longest_lease_ms,
                longest_waveform_ms=configuration.longest_waveform_ms,
                basis_capacity_bytes=configuration.basis_capacity_bytes,
                held_basis_hash=held_basis_hash,
                number_of_actuators=configuration.number_of_actuators,
                full_scales_pm=configuration.full_scales_pm or (FULL_SCALE_PM,) * configuration.number_of_actuators,
            )
        )

    def send_ack(self, acknowledged_type: int, sequence: int, result: messages.Result) -> None:
        """Answer a request."""
        self.send(messages.Ack(acknowledged_type, sequence, result))

    def send_time(self, host_sent_ns: int) -> None:
        """Answer a time request."""
        self.send(messages.Time(host_sent_ns, self._device.now_us, self._device.now_us))

    def send_log(self, level: messages.LogLevel, code: messages.LogCode, value: int) -> None:
        """Tell something, unless the last LOG was just now."""
        now_us = self._device.now_us
        if now_us >= self._log_allowed_us:
            self._log_allowed_us = now_us + LOG_SPACING_US
            self.send(messages.Log(level, code, value, now_us))

    def raise_fault(self, fault: messages.FaultCode) -> None:
        """Send FAULT from now on until it is settled."""
        self._fault, self._fault_sequence = fault, self._encoder.next_sequence()
        self._fault_time_us = self.fault_due_us = self._device.now_us

    def settle_fault(self, ack: messages.Ack) -> bool:
        """The host acknowledged; False where it meant another message."""
        if (ack.acknowledged_type, ack.acknowledged_sequence) != (messages.Fault.type_byte, self._fault_sequence):
            return False
        self._fault, self.fault_due_us = messages.FaultCode.NONE, None
        return True

    def send_due(self) -> None:
        """Send what is due."""
        device, now_us = self._device, self._device.now_us
        if self.fault_due_us is not None and self.fault_due_us <= now_us:
            self._outgoing.append(
                encode_message(messages.Fault(self._fault, self._fault_time_us), self._fault_sequence)
            )
            self.fault_due_us = now_us + FAULT_PERIOD_US
        if device.status_due_us is not None and device.status_due_us <= now_us:
            self._send_status()
            self.status_allowed_us = now_us + STATUS_SPACING_US
            device.status_due_us = now_us + STATUS_PERIOD_US

    def _send_status(self) -> None:
        device = self._device
        self.send(
            messages.Status(
                state=device.state,
                fault=self._fault,
                applied_sequence=self.applied_sequence,
                device_time_us=device.now_us,
                applied_time_us=self.applied_time_us,
                high_voltage_dv=0,
                **asdict(self._framing_counters),
                **asdict(device.counters),
            )
        )

    def send(self, message: Message) -> None:
        """Say this, under the next sequence number."""
        self._outgoing.append(self._encoder.encode(message))
