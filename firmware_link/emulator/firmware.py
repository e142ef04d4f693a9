"""The emulated firmware: bytes and time in, bytes and a drive log out."""

from dataclasses import dataclass

from firmware_link.emulator.channels import Channels
from firmware_link.emulator.drive_log import Cause, DriveEvent, Outcome, PlayedWaveform, ReceivedFrame
from firmware_link.protocol.bank import Bank, BankStore
from firmware_link.protocol.errors import MessageError
from firmware_link.protocol.framing import FrameDecoder, FramingCounters, Signal, encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import (
    CLOCK_REFERENCE_SPAN,
    CLOCK_REFERENCE_US,
    FULL_SCALE_WORD,
    MAGIC,
    SCHEMA_HASH,
    VERSION_MAJOR,
    VERSION_MINOR,
    Ack,
    Arm,
    BankBegin,
    BankChunk,
    BankCommit,
    DeviceState,
    Fault,
    FaultCode,
    Features,
    Hello,
    HelloRequest,
    KeepAlive,
    Log,
    LogCode,
    LogLevel,
    Play,
    Result,
    Set,
    SetFlag,
    Status,
    Stop,
    Time,
    TimeRequest,
    decode_body,
)
from firmware_link.protocol.player import Player

US_PER_MS = 1_000
US_PER_S = 1_000_000
# Nothing fresh for this long: disarmed until a new handshake. Not configurable: it can't be switched off.
DISARM_US = 250 * US_PER_MS
LONGEST_LEASE_MS = 100
STATUS_PERIOD_US = 100 * US_PER_MS
# A new drive is reported this soon; more often would crowd a slow line.
STATUS_SPACING_US = 10 * US_PER_MS
FAULT_PERIOD_US = 100 * US_PER_MS
LOG_SPACING_US = 10 * US_PER_MS
FULL_SCALE_PM = 520_000
BANK_CAPACITY_BYTES = 1 << 18
LONGEST_WAVEFORM_MS = 1_000
BOARD_EMULATED = 0


@dataclass(frozen=True)
class DeviceConfiguration:
    """What the emulated board is; frequencies in steps of the resolution, slew in full scale a second.

    Without `full_scales_pm` each is FULL_SCALE_PM. A `bank_capacity_bytes` of 0 is a device without waveforms, a
    `longest_drive_s` of 0 one without its own limit.
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
    bank_capacity_bytes: int = BANK_CAPACITY_BYTES
    longest_waveform_ms: int = LONGEST_WAVEFORM_MS
    longest_drive_s: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.longest_lease_ms <= LONGEST_LEASE_MS:
            raise ValueError(f"longest_lease_ms is {self.longest_lease_ms}; expected 1 to {LONGEST_LEASE_MS}")
        if not 1 <= self.number_of_actuators <= 255:
            raise ValueError(f"number_of_actuators is {self.number_of_actuators}; expected 1 to 255")
        if len(self.full_scales_pm) not in (0, self.number_of_actuators):
            raise ValueError(f"{len(self.full_scales_pm)} full scales for {self.number_of_actuators} actuators")


@dataclass
class DeviceCounters:
    """What the firmware counted since boot, beside its framing counters; `applied` are SET and PLAY."""

    applied: int = 0
    stale: int = 0
    refused: int = 0
    trips: int = 0


class EmulatedFirmware:
    """The reference firmware with virtual time: whoever calls it owns the clock, which must not run backwards.

    `drive_log`, `received` and `banks` (every bank that was held, by its hash) grow with what happens.
    """

    def __init__(self, configuration: DeviceConfiguration) -> None:
        self.configuration = configuration
        self.state = DeviceState.IDLE
        self.counters = DeviceCounters()
        self.drive_log: list[DriveEvent] = []
        self.received: list[ReceivedFrame] = []
        self.banks: dict[int, Bank] = {}
        self._decoder = FrameDecoder(configuration.number_of_actuators)
        self._channels = Channels(
            configuration.number_of_actuators,
            configuration.frequency_resolution_uhz * 1e-6,
            configuration.frequency_minimum,
            configuration.frequency_maximum,
        )
        self._player = Player()
        self._store = BankStore(
            configuration.bank_capacity_bytes, configuration.longest_waveform_ms, configuration.number_of_actuators
        )
        self._now_us = 0
        self._outgoing: list[bytes] = []
        self._sequence = 0
        self._armed_lease_us = 0
        self._drive_lease_us = 0
        self._longest_drive_us: int | None = None
        self._driving_since_us = 0
        self._fresh_us = 0
        self._renewed_us = 0
        self._fresh_sequence = 0
        self._applied_sequence = 0
        self._applied_time_us = 0
        self._fault = FaultCode.NONE
        self._fault_sequence = 0
        self._fault_time_us = 0
        self._fault_due_us: int | None = None
        self._status_due_us: int | None = None
        self._status_sent_us = -STATUS_SPACING_US
        self._log_sent_us = -LOG_SPACING_US
        self._was_greeted = False

    @property
    def framing_counters(self) -> FramingCounters:
        """Frames accepted and refused since boot."""
        return self._decoder.counters

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that came at `now_us`; returns what the device sends until then."""
        self._advance(now_us)
        for item in self._decoder.receive(data):
            if isinstance(item, Signal):
                self._latch(FaultCode.EMERGENCY_STOP, Cause.EMERGENCY_STOP)
            else:
                self._dispatch(item)
        self._advance(now_us)
        return self._take_outgoing()

    def advance(self, now_us: int) -> bytes:
        """Let time pass up to `now_us`; returns what the device sends until then."""
        self._advance(now_us)
        return self._take_outgoing()

    def hang_up(self, now_us: int) -> bytes:
        """The host let go of the line, or pulled it; returns what the device sends until then."""
        self._advance(now_us)
        if self.state in (DeviceState.ARMED, DeviceState.DRIVING):
            self._latch(FaultCode.HUNG_UP, Cause.HUNG_UP)
        self._advance(now_us)
        return self._take_outgoing()

    def next_deadline_us(self) -> int | None:
        """When the device acts by itself next; None while it waits for a host."""
        deadlines = (
            self._player.end_us,
            self._lease_end_us(),
            self._on_time_end_us(),
            self._watchdog_end_us(),
            self._fault_due_us,
            self._status_due_us,
        )
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def _advance(self, now_us: int) -> None:
        while (deadline_us := self.next_deadline_us()) is not None and deadline_us <= now_us:
            self._now_us = max(deadline_us, self._now_us)
            self._act_on_deadlines()
        self._now_us = now_us

    def _act_on_deadlines(self) -> None:
        now_us = self._now_us
        if _is_due(self._player.end_us, now_us):
            self._player.finish()
            self._enter(DeviceState.ARMED)
        if _is_due(self._lease_end_us(), now_us):
            self.counters.trips += 1
            self._silence(DeviceState.ARMED, Cause.LEASE_EXPIRED)
            self._tell(LogLevel.WARNING, LogCode.LEASE_EXPIRED, self._applied_sequence)
        if _is_due(self._on_time_end_us(), now_us):
            self._latch(FaultCode.DRIVEN_TOO_LONG, Cause.DRIVEN_TOO_LONG)
        if _is_due(self._watchdog_end_us(), now_us):
            self._latch(FaultCode.SILENT_HOST, Cause.SILENT_HOST)
        if _is_due(self._fault_due_us, now_us):
            self._send_as(Fault(self._fault, self._fault_time_us), self._fault_sequence)
            self._fault_due_us = now_us + FAULT_PERIOD_US
        if _is_due(self._status_due_us, now_us):
            self._send(self._status())
            self._status_sent_us = now_us
            self._status_due_us = now_us + STATUS_PERIOD_US

    def _lease_end_us(self) -> int | None:
        return self._renewed_us + self._drive_lease_us if self._channels.is_driving else None

    def _on_time_end_us(self) -> int | None:
        if self._longest_drive_us is None or self.state is not DeviceState.DRIVING:
            return None
        return self._driving_since_us + self._longest_drive_us

    def _watchdog_end_us(self) -> int | None:
        return self._fresh_us + DISARM_US if self.state in (DeviceState.ARMED, DeviceState.DRIVING) else None

    def _dispatch(self, body: bytes) -> None:
        try:
            sequence, message = decode_body(body)
        except MessageError:
            self.counters.refused += 1
            return
        outcome = self._act_on(message, sequence)
        self.counters.stale += outcome is Outcome.STALE
        self.counters.refused += outcome is Outcome.REFUSED
        self.received.append(ReceivedFrame(self._now_us, message.wire_name, sequence, outcome))

    def _act_on(self, message: Message, sequence: int) -> Outcome:
        match message:
            case Set():
                return self._set(message, sequence)
            case Play():
                return self._play(message, sequence)
            case KeepAlive():
                return self._keep_alive(message, sequence)
            case HelloRequest():
                return self._greet(message)
            case Arm():
                return self._acknowledge(message, sequence, self._arm(message, sequence))
            case Stop():
                self._silence(DeviceState.LATCHED, Cause.STOP)
                return self._acknowledge(message, sequence, Result.OK)
            case TimeRequest():
                self._send(Time(message.host_sent_ns, self._now_us, self._now_us))
                return Outcome.ACCEPTED
            case BankBegin() | BankChunk() | BankCommit():
                return self._keep(message, sequence)
            case Ack():
                return self._settle_fault(message)
        return Outcome.REFUSED

    def _greet(self, request: HelloRequest) -> Outcome:
        if request.magic != MAGIC:
            return Outcome.REFUSED
        self._silence(DeviceState.IDLE, Cause.NEW_SESSION)
        self._store.end_transfer()
        self._send(self._hello(request.nonce))
        if not self._was_greeted:
            self._was_greeted = True
            self._tell(LogLevel.INFORMATION, LogCode.BOOTED, 0)
        self._report_by(self._now_us)
        return Outcome.ACCEPTED

    def _keep(self, message: BankBegin | BankChunk | BankCommit, sequence: int) -> Outcome:
        """One step of the transfer of a bank."""
        held_hash = self._store.held_hash
        result = Result.WRONG_STATE if self.state is DeviceState.LATCHED else self._take(message)
        outcome = self._acknowledge(message, sequence, result)
        if self._store.bank is not None and self._store.held_hash != held_hash:
            self.banks[self._store.held_hash] = self._store.bank
            self._tell(LogLevel.INFORMATION, LogCode.BANK_TAKEN, self._store.held_hash)
        return outcome

    def _take(self, message: BankBegin | BankChunk | BankCommit) -> Result:
        match message:
            case BankBegin():
                return self._store.begin(message, may_forget=self.state is DeviceState.IDLE)
            case BankChunk():
                return self._store.take(message)
            case BankCommit():
                return self._store.commit(message)

    def _arm(self, arm: Arm, sequence: int) -> Result:
        if arm.boot_id != self.configuration.boot_id:
            return Result.WRONG_BOOT
        if self.state not in (DeviceState.IDLE, DeviceState.ARMED):
            return Result.WRONG_STATE
        if not (arm.slew_limit_per_s and 1 <= arm.lease_ms <= self.configuration.longest_lease_ms):
            return Result.OUT_OF_RANGE
        limits = tuple(min(limit, self.configuration.amplitude_limit) for limit in arm.amplitude_limits)
        self._channels.limit(limits, min(arm.slew_limit_per_s, self.configuration.slew_limit_per_s))
        self._armed_lease_us = arm.lease_ms * US_PER_MS
        on_times_s = [limit_s for limit_s in (arm.longest_drive_s, self.configuration.longest_drive_s) if limit_s]
        self._longest_drive_us = min(on_times_s) * US_PER_S if on_times_s else None
        self._refresh(sequence)
        self._enter(DeviceState.ARMED)
        return Result.OK

    def _set(self, message: Set, sequence: int) -> Outcome:
        outcome = self._judge(message.clock_reference, sequence)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        event = self._channels.apply(
            message.drive,
            SetFlag.WRITE_PHASE in message.flags,
            self._now_us,
            sequence,
            takes_over=self._player.end_us is not None,
        )
        self._player.take_over(self._now_us, self._channels.slew_per_s)
        self._renewed_us, self._drive_lease_us = self._now_us, min(message.lease_ms * US_PER_MS, self._armed_lease_us)
        self._applied(event, sequence)
        return outcome

    def _play(self, message: Play, sequence: int) -> Outcome:
        outcome = self._judge(message.clock_reference, sequence)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        bank = self._store.bank
        if bank is None or message.waveform >= len(bank.waveforms) or not self._player.has_room(self._now_us):
            self._tell(LogLevel.WARNING, LogCode.PLAY_REFUSED, message.waveform)
            return Outcome.REFUSED
        waveform = PlayedWaveform(self._store.held_hash, message.waveform, message.amplitude / FULL_SCALE_WORD)
        event = self._channels.play(waveform, self._now_us, sequence)
        self._player.take_over(self._now_us, self._channels.slew_per_s)
        self._player.start(self._now_us, bank.length_us(message.waveform), message.amplitude)
        self._applied(event, sequence)
        return outcome

    def _applied(self, event: DriveEvent | None, sequence: int) -> None:
        if event is not None:
            self.drive_log.append(event)
        self._refresh(sequence)
        self.counters.applied += 1
        self._applied_sequence, self._applied_time_us = sequence, self._now_us
        self._report_by(max(self._now_us, self._status_sent_us + STATUS_SPACING_US))
        self._enter(DeviceState.DRIVING if self._sounds else DeviceState.ARMED)

    def _keep_alive(self, message: KeepAlive, sequence: int) -> Outcome:
        outcome = self._judge(message.clock_reference, sequence)
        if outcome is Outcome.ACCEPTED:
            self._refresh(sequence)
            if message.applied_sequence == self._applied_sequence:
                self._renewed_us = self._now_us
        return outcome

    def _judge(self, clock_reference: int, sequence: int) -> Outcome:
        """Fresh: within one lease by the clock, and later in sequence than what came within the last two."""
        if self.state not in (DeviceState.ARMED, DeviceState.DRIVING):
            return Outcome.REFUSED
        half_span = CLOCK_REFERENCE_SPAN // 2
        age = (self._now_us // CLOCK_REFERENCE_US - clock_reference + half_span) % CLOCK_REFERENCE_SPAN - half_span
        if abs(age) * CLOCK_REFERENCE_US > self._armed_lease_us:
            return Outcome.STALE
        # A frame may seem up to one lease young, so its copy can pass the clock for two leases.
        is_held = self._now_us <= self._fresh_us + 2 * self._armed_lease_us
        if is_held and not 1 <= (sequence - self._fresh_sequence) % 256 <= 127:
            return Outcome.STALE
        return Outcome.ACCEPTED

    def _refresh(self, sequence: int) -> None:
        self._fresh_us, self._fresh_sequence = self._now_us, sequence

    def _settle_fault(self, ack: Ack) -> Outcome:
        if (ack.acknowledged_type, ack.acknowledged_sequence) != (Fault.type_byte, self._fault_sequence):
            return Outcome.REFUSED
        self._fault, self._fault_due_us = FaultCode.NONE, None
        return Outcome.ACCEPTED

    def _latch(self, fault: FaultCode, cause: Cause) -> None:
        self._silence(DeviceState.LATCHED, cause)
        self._fault, self._fault_time_us, self._fault_due_us = fault, self._now_us, self._now_us
        self._fault_sequence = self._next_sequence()

    def _silence(self, state: DeviceState, cause: Cause) -> None:
        if self._sounds:
            self.drive_log.append(self._channels.silence(self._now_us, cause))
            self._player.take_over(self._now_us, self._channels.slew_per_s)
        self._enter(state)

    @property
    def _sounds(self) -> bool:
        return self._channels.is_driving or self._player.end_us is not None

    def _enter(self, state: DeviceState) -> None:
        if state is not self.state:
            self.state = state
            self._driving_since_us = self._now_us
            self._report_by(self._now_us)

    def _report_by(self, due_us: int) -> None:
        self._status_due_us = due_us if self._status_due_us is None else min(self._status_due_us, due_us)

    def _acknowledge(self, message: Message, sequence: int, result: Result) -> Outcome:
        self._send(Ack(message.type_byte, sequence, result))
        return Outcome.ACCEPTED if result is Result.OK else Outcome.REFUSED

    def _hello(self, nonce: int) -> Hello:
        configuration = self.configuration
        return Hello(
            version_major=VERSION_MAJOR,
            version_minor=VERSION_MINOR,
            nonce=nonce,
            boot_id=configuration.boot_id,
            schema_hash=SCHEMA_HASH,
            features=Features.WAVEFORMS if configuration.bank_capacity_bytes else Features(0),
            firmware_major=0,
            firmware_minor=1,
            firmware_patch=0,
            board=BOARD_EMULATED,
            synthesis_rate_hz=configuration.synthesis_rate_hz,
            frequency_resolution_uhz=configuration.frequency_resolution_uhz,
            frequency_minimum=configuration.frequency_minimum,
            frequency_maximum=configuration.frequency_maximum,
            longest_lease_ms=configuration.longest_lease_ms,
            longest_waveform_ms=configuration.longest_waveform_ms,
            bank_capacity_bytes=configuration.bank_capacity_bytes,
            held_bank_hash=self._store.held_hash,
            number_of_actuators=configuration.number_of_actuators,
            full_scales_pm=configuration.full_scales_pm or (FULL_SCALE_PM,) * configuration.number_of_actuators,
        )

    def _status(self) -> Status:
        counters, framing = self.counters, self._decoder.counters
        return Status(
            state=self.state,
            fault=self._fault,
            applied_sequence=self._applied_sequence,
            device_time_us=self._now_us,
            applied_time_us=self._applied_time_us,
            high_voltage_dv=0,
            applied=counters.applied,
            ok=framing.ok,
            crc=framing.crc,
            framing=framing.framing,
            length=framing.length,
            overrun=framing.overrun,
            stale=counters.stale,
            refused=counters.refused,
            trips=counters.trips,
        )

    def _tell(self, level: LogLevel, code: LogCode, value: int) -> None:
        if self._now_us >= self._log_sent_us + LOG_SPACING_US:
            self._log_sent_us = self._now_us
            self._send(Log(level, code, value, self._now_us))

    def _next_sequence(self) -> int:
        self._sequence = (self._sequence + 1) % 256
        return self._sequence

    def _send(self, message: Message) -> None:
        self._send_as(message, self._next_sequence())

    def _send_as(self, message: Message, sequence: int) -> None:
        self._outgoing.append(encode_message(message, sequence))

    def _take_outgoing(self) -> bytes:
        outgoing, self._outgoing = b"".join(self._outgoing), []
        return outgoing


def _is_due(deadline_us: int | None, now_us: int) -> bool:
    return deadline_us is not None and deadline_us <= now_us
