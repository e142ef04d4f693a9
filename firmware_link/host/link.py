"""Host side of the wire without I/O: bytes and time in, events and bytes out."""

from collections.abc import Callable
from dataclasses import replace

from firmware_link.host.bank_transfer import BankTransfer
from firmware_link.host.clock import NS_PER_S, DeviceClock, Exchange
from firmware_link.host.link_values import (
    Ahead,
    Armed,
    BankRefused,
    BankReplaced,
    Capabilities,
    Event,
    FaultReceived,
    Greeted,
    LinkConfiguration,
    LinkCounters,
    LinkState,
    LogReceived,
    StatusReceived,
    Stopped,
)
from firmware_link.host.outbox import Outbox, WantedDrive, WantedWaveform
from firmware_link.protocol.bank import Bank, encode_bank, hash_of_bank, transfer_messages
from firmware_link.protocol.errors import LinkError, LinkLostError, MessageError
from firmware_link.protocol.framing import (
    DELIMITER,
    FrameDecoder,
    FramingCounters,
    Signal,
    encode_frame,
    encode_message,
)
from firmware_link.protocol.layout import Message
from firmware_link.protocol.line_rate import EXCHANGE_PERIOD_NS, occupied_ns
from firmware_link.protocol.messages import (
    CLOCK_REFERENCE_SPAN,
    CLOCK_REFERENCE_US,
    DRIVE_SIZE,
    MAGIC,
    SCHEMA_HASH,
    VERSION_MAJOR,
    VERSION_MINOR,
    Ack,
    Arm,
    DeviceState,
    Fault,
    Features,
    Hello,
    HelloRequest,
    Log,
    Result,
    Status,
    Stop,
    Time,
    TimeRequest,
    decode_body,
    encode_amplitude,
    encode_play_body,
    encode_set_body,
)

NS_PER_MS = 1_000_000
US_PER_MS = 1_000
RETRY_NS = 100 * NS_PER_MS
STOP_RETRY_NS = 20 * NS_PER_MS
STOP_PATIENCE_NS = NS_PER_S
# A status comes every 100 ms: ten lost in a row are no accident.
SILENCE_NS = NS_PER_S
FIRST_EXCHANGES = 16
# The hot path: without the search in the class.
_READY = LinkState.READY
# A device that was rebooted or latched since it was greeted says so.
_FORGOTTEN = (Result.WRONG_BOOT, Result.WRONG_STATE)


class Link:
    """One session with a device, owned by one loop.

    The loop calls `receive` with what came, `poll`, `outgoing` for what to write, and comes back no later than
    `next_deadline_ns`. Nothing is sent but by `outgoing`: a loop that hangs renews nothing, and the device falls
    silent. Times are host monotonic nanoseconds; give `receive` a time taken after the read and `outgoing` one taken
    before the write, so that the clock bounds hold. After any LinkError, and after STOPPED, only `connect` goes on.
    """

    def __init__(self, configuration: LinkConfiguration) -> None:
        self.configuration = configuration
        limits = configuration.amplitude_limits or (1.0,) * configuration.number_of_actuators
        self._amplitude_limits = tuple(encode_amplitude(limit) for limit in limits)
        self.counters = LinkCounters()
        self.state = LinkState.DISCONNECTED
        self.capabilities: Capabilities | None = None
        self.clock = DeviceClock()
        self.status: Status | None = None
        self.drive_sequence: int | None = None
        self._decoder = FrameDecoder()
        self._sequence = 0
        self._nonce = 0
        self._arm: Arm | None = None
        self._lease_ms = configuration.lease_ms
        self._preparations: list[Message] = []
        self._prepared_frame = b""
        self._prepared_sequence = 0
        self._replies: list[bytes] = []
        self._outbox = Outbox(self.counters, configuration.slew_limit_per_s)
        self._due_ns = 0
        self._patience_end_ns: int | None = None
        self._line_free_ns = 0
        self._occupied_by_size_ns: dict[int, int] = {}
        self._waveforms: dict[tuple[int, float], WantedWaveform] = {}  # those that were asked for
        self._connected_ns = 0
        self._arming_device_us = 0
        self._transfer: BankTransfer | None = None

    @property
    def framing_counters(self) -> FramingCounters:
        """Frames from the device, accepted and refused."""
        return self._decoder.counters

    def connect(self, now_ns: int) -> None:
        """Start a new session, whatever was before: greet, hand the bank over, compare clocks, arm."""
        self.state = LinkState.GREETING
        self.capabilities, self.status, self.drive_sequence = None, None, None
        self.clock = DeviceClock()
        self._nonce = now_ns % 2**32
        self._preparations, self._replies, self._transfer = [], [], None
        self._outbox.start(b"", self.configuration.lease_ms)
        self._connected_ns = self._due_ns = self._line_free_ns = now_ns
        self._patience_end_ns = now_ns + int(self.configuration.handshake_timeout_s * NS_PER_S)

    def set_drive(self, drive: bytes) -> None:
        """Drive this next, from `encode_drive`; replaces what is not sent yet. Dropped and counted unless READY.

        The device gets silence on actuators beyond those of the drive. Raises LinkError for a drive too long.
        """
        if self.state is not _READY:
            self.counters.dropped += 1
            return
        size = len(self._outbox.silent_drive)
        if len(drive) != size:
            if len(drive) > size:
                raise LinkError(f"a drive of {len(drive)} bytes; the device takes {size}")
            drive = drive.ljust(size, b"\0")
        self._outbox.put(WantedDrive(drive))

    def set_play(self, waveform: int, amplitude: float = 1.0) -> None:
        """Play a waveform of the bank next, in place of what sounds; silence follows. As `set_drive` otherwise.

        Raises LinkError for a waveform that is not in the bank, or an amplitude outside 0 … 1.
        """
        if self.state is not LinkState.READY:
            self.counters.dropped += 1
            return
        wanted = self._waveforms.get((waveform, amplitude))
        if wanted is None:
            wanted = self._waveforms[waveform, amplitude] = self._find_waveform(waveform, amplitude)
        self._outbox.put(wanted)

    def _find_waveform(self, waveform: int, amplitude: float) -> WantedWaveform:
        bank = self.configuration.bank
        if bank is None or not 0 <= waveform < len(bank.waveforms):
            raise LinkError(f"waveform {waveform} is not in the bank of this link: configure a bank that has it")
        return WantedWaveform(waveform, encode_amplitude(amplitude), bank.length_us(waveform))

    def replace_bank(self, bank: Bank, data: bytes) -> None:
        """Hand another bank over while the device plays the one it has; `data` are its bytes for the device.

        BankReplaced or BankRefused tells the end. Waveforms wait while the device changes over; one that waits then
        means the new bank. An end of the session ends the transfer too. Raises LinkError unless READY, and for a bank
        that the device has no room for at all.
        """
        if self.state is not _READY or self.capabilities is None:
            raise LinkError("no bank is handed over before the device is armed: configure it, or wait")
        _check_bank(self.capabilities, len(data), max(map(bank.length_us, range(len(bank.waveforms)))))
        self._transfer = BankTransfer(bank, data, lambda message: (self._frame(message), self._sequence))

    def reconfigure(self, configuration: LinkConfiguration) -> None:
        """Limits and bank from the next `connect` on."""
        self.configuration = configuration
        limits = configuration.amplitude_limits or (1.0,) * configuration.number_of_actuators
        self._amplitude_limits = tuple(encode_amplitude(limit) for limit in limits)
        self._lease_ms = configuration.lease_ms
        self._outbox = Outbox(self.counters, configuration.slew_limit_per_s)
        self._occupied_by_size_ns, self._waveforms = {}, {}

    def set_silent(self) -> None:
        """Ramp every actuator to zero and stay armed; nothing to send where all is silent already."""
        if not self._outbox.is_silent:
            self.set_drive(self._outbox.silent_drive)

    def stop(self, now_ns: int) -> None:
        """Ramp to zero and latch: STOP goes out before anything else, until it is acknowledged."""
        self._outbox.clear()
        if self.state is not LinkState.DISCONNECTED:
            self.state = LinkState.STOPPING
            self._due_ns, self._line_free_ns = now_ns, now_ns
            self._patience_end_ns = now_ns + STOP_PATIENCE_NS

    def disconnect(self) -> None:
        """Forget the session, as after an unplug."""
        self._end_session(LinkState.DISCONNECTED)
        self._replies = []

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """Take bytes in; raises LinkError when the device does not fit or refuses to arm."""
        events: list[Event] = []
        for item in self._decoder.receive(data):
            if isinstance(item, Signal) or self.state is LinkState.DISCONNECTED:
                continue
            try:
                sequence, message = decode_body(item)
            except MessageError:
                self.counters.unexpected += 1
                continue
            event = self._act_on(message, sequence, now_ns)
            if event is not None:
                events.append(event)
        return events

    def poll(self, now_ns: int) -> None:
        """Raises LinkLostError when the device has been silent for too long."""
        if self._patience_end_ns is None or now_ns < self._patience_end_ns:
            return
        state = self.state
        self.disconnect()
        raise LinkLostError(
            f"no answer from the device while {state.value}: check that it is powered, that the port is the right one "
            "and that its firmware speaks this protocol, then connect again"
        )

    def outgoing(self, now_ns: int) -> bytes:
        """What to write now, at most one SET; nothing while the last write still occupies the line."""
        if now_ns < self._line_free_ns:
            return b""
        frames = self._next_frame(now_ns)
        if self._replies:
            frames += b"".join(self._replies)
            self._replies = []
        if frames:
            self._line_free_ns = now_ns + self._occupied_ns(len(frames))
        return frames

    def next_deadline_ns(self) -> int | None:
        """When `outgoing` or `poll` has something to do without new bytes, perhaps in the past; None for never."""
        if self.state is _READY:
            send_ns = min(self._due_ns, self._outbox.due_ns(self._line_free_ns))
            if self._transfer is not None:
                send_ns = min(send_ns, self._transfer.due_ns)
        elif self.state is LinkState.DISCONNECTED:
            return None
        elif self.state is LinkState.STOPPED and not self._replies:
            return self._patience_end_ns
        else:
            send_ns = self._line_free_ns if self.state is LinkState.STOPPED else self._due_ns
        if self._replies:
            send_ns = min(send_ns, self._line_free_ns)
        deadline_ns = max(send_ns, self._line_free_ns)
        return deadline_ns if self._patience_end_ns is None else min(deadline_ns, self._patience_end_ns)

    def ahead(self, now_ns: int) -> Ahead | None:
        """What the next command would be sent with, if nothing else happens before; None where something waits."""
        if self.state is not _READY or self._replies:
            return None
        free_from_ns = self._outbox.free_from_ns(now_ns)
        if free_from_ns is None:
            return None
        lease_ms, drive_size = self._outbox.lease_ms, len(self._outbox.silent_drive)
        clock_at_ns, middle_ns, drift = self.clock.line()
        free = (self._line_free_ns, *free_from_ns)
        return Ahead(lease_ms, drive_size, *free, self._sequence, clock_at_ns, middle_ns, drift)

    def _next_frame(self, now_ns: int) -> bytes:
        if self.state is _READY:  # first: the others have time
            return (
                self._drive_frame(now_ns)
                or self._transfer_frame(now_ns)
                or self._repeat(self._time_request, EXCHANGE_PERIOD_NS, now_ns)
            )
        match self.state:
            case LinkState.GREETING:
                return self._repeat(self._hello_request, RETRY_NS, now_ns)
            case LinkState.PREPARING:
                return self._repeat(lambda _: self._prepared_frame, RETRY_NS, now_ns)
            case LinkState.SYNCHRONISING:
                return self._repeat(self._time_request, RETRY_NS, now_ns)
            case LinkState.ARMING:
                return self._repeat(self._arm_request, RETRY_NS, now_ns)
            case LinkState.STOPPING:
                return self._repeat(lambda _: self._frame(Stop()), STOP_RETRY_NS, now_ns)
        return b""

    def _repeat(self, frame: Callable[[int], bytes], period_ns: int, now_ns: int) -> bytes:
        if now_ns < self._due_ns:
            return b""
        data = frame(now_ns)
        self._due_ns = now_ns + period_ns + self._occupied_ns(len(data))
        return data

    def _occupied_ns(self, size: int) -> int:
        duration_ns = self._occupied_by_size_ns.get(size)
        if duration_ns is None:
            duration_ns = occupied_ns(self.configuration.transport, self.configuration.bit_rate_hz, size)
            self._occupied_by_size_ns[size] = duration_ns
        return duration_ns

    def _frame(self, message: Message) -> bytes:
        self._sequence = (self._sequence + 1) % 256
        return encode_message(message, self._sequence)

    def _hello_request(self, _: int) -> bytes:
        # The leading delimiter parts the frame from what a boot loader or modem left on the line.
        return DELIMITER + self._frame(HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, self._nonce))

    def _time_request(self, now_ns: int) -> bytes:
        return self._frame(TimeRequest(now_ns))

    def _arm_request(self, _: int) -> bytes:
        return self._frame(self._arm) if self._arm else b""

    def _drive_frame(self, now_ns: int) -> bytes:
        wanted = self._outbox.next_command(now_ns)
        if wanted is not None:
            sequence = self._sequence = self.drive_sequence = (self._sequence + 1) % 256
            reference = self._clock_reference(now_ns)
            if isinstance(wanted, WantedDrive):
                return encode_frame(encode_set_body(reference, self._outbox.lease_ms, wanted.drive, sequence))
            return encode_frame(encode_play_body(reference, wanted.waveform, wanted.amplitude, sequence))
        message, is_command = self._outbox.next_message(now_ns, self._clock_reference, self.drive_sequence)
        if message is None:
            return b""
        frame = self._frame(message)
        if is_command:
            self.drive_sequence = self._sequence
        return frame

    def _transfer_frame(self, now_ns: int) -> bytes:
        if self._transfer is None:
            return b""
        frame = self._transfer.next_frame(now_ns)
        self._outbox.holds_waveforms = self._transfer.is_committing
        return frame

    def _clock_reference(self, now_ns: int) -> int:
        return self.clock.device_time_us(now_ns) // CLOCK_REFERENCE_US % CLOCK_REFERENCE_SPAN

    def _act_on(self, message: Message, sequence: int, now_ns: int) -> Event | None:
        match message:
            case Hello() if self.state is LinkState.GREETING and message.nonce == self._nonce:
                return self._greeted(message, now_ns)
            case Time() if self._connected_ns <= message.host_sent_ns <= now_ns:
                self._compare_clocks(message, now_ns)
                return None
            case Ack():
                return self._acknowledged(message, now_ns)
            case Status():
                return self._reported(message, now_ns)
            case Fault():
                return self._faulted(message, sequence)
            case Log():
                self.counters.logs += 1
                return LogReceived(message.level, message.code, message.value, message.device_time_us, message.text)
        self.counters.unexpected += 1
        return None

    def _greeted(self, hello: Hello, now_ns: int) -> Event:
        try:
            _check_fit(hello, self.configuration)
            self._preparations = self._prepare(hello)
        except LinkError:
            self.disconnect()
            raise
        self.capabilities = Capabilities.from_hello(hello)
        lease_ms = min(self.configuration.lease_ms, hello.longest_lease_ms)
        self._outbox.start(bytes(DRIVE_SIZE * hello.number_of_actuators), lease_ms)
        unused = (0,) * (hello.number_of_actuators - len(self._amplitude_limits))
        limits = self._amplitude_limits + unused
        slew_limit_per_s, longest_drive_s = self.configuration.slew_limit_per_s, self.configuration.longest_drive_s
        self._arm = Arm(hello.boot_id, slew_limit_per_s, lease_ms, longest_drive_s, limits)
        self._prepare_next(now_ns)
        return Greeted(self.capabilities)

    def _prepare(self, hello: Hello) -> list[Message]:
        """What the device must know before it is armed, in order."""
        bank = self.configuration.bank
        if bank is None:
            return []
        data = encode_bank(bank, hello.number_of_actuators)
        _check_bank(hello, len(data), max(map(bank.length_us, range(len(bank.waveforms)))))
        return [] if hello.held_bank_hash == hash_of_bank(data) else [*transfer_messages(data)]

    def _prepare_next(self, now_ns: int) -> None:
        self._due_ns = now_ns
        if not self._preparations:
            self.state = LinkState.SYNCHRONISING
            return
        self.state = LinkState.PREPARING
        # Sent again as it is, so that an answer tells by its sequence what it answers.
        self._prepared_frame = self._frame(self._preparations[0])
        self._prepared_sequence = self._sequence

    def _answers_preparation(self, ack: Ack) -> bool:
        answered = (ack.acknowledged_type, ack.acknowledged_sequence)
        return answered == (self._preparations[0].type_byte, self._prepared_sequence)

    def _compare_clocks(self, time: Time, now_ns: int) -> None:
        self.clock.update(Exchange(time.host_sent_ns, time.device_received_us, time.device_sent_us, now_ns))
        if self.state is LinkState.SYNCHRONISING:
            self._due_ns = now_ns
            if self.clock.exchanges >= FIRST_EXCHANGES:
                self.state = LinkState.ARMING
                self._arming_device_us = self.clock.device_time_us(now_ns)

    def _acknowledged(self, ack: Ack, now_ns: int) -> Event | None:
        if self._transfer is not None and self._transfer.answers(ack):
            return self._handed_over(self._transfer, ack.result, now_ns)
        answer = (self.state, ack.acknowledged_type)
        is_prepared = self.state is LinkState.PREPARING and self._answers_preparation(ack)
        if ack.result is not Result.OK:
            self.counters.refused += 1
            if answer != (LinkState.ARMING, Arm.type_byte) and not is_prepared:
                return None
            self.disconnect()
            asked, remedy = ("take the bank", "it") if is_prepared else ("arm", "the limits")
            refusal = LinkLostError if ack.result in _FORGOTTEN else LinkError
            raise refusal(f"the device refused to {asked} ({ack.result.name}): connect again, or correct {remedy}")
        self.counters.acknowledged += 1
        if is_prepared:
            del self._preparations[0]
            self._prepare_next(now_ns)
            # A bank takes as long as it takes; each answer shows that it goes on.
            self._patience_end_ns = now_ns + int(self.configuration.handshake_timeout_s * NS_PER_S)
        elif answer == (LinkState.ARMING, Arm.type_byte):
            self.state = LinkState.READY
            self._due_ns = now_ns + EXCHANGE_PERIOD_NS
            self._outbox.renew_at(now_ns)
            self._patience_end_ns = now_ns + SILENCE_NS
            return Armed()
        if answer == (LinkState.STOPPING, Stop.type_byte):
            self._end_session(LinkState.STOPPED)
            return Stopped()
        return None

    def _handed_over(self, transfer: BankTransfer, result: Result, now_ns: int) -> Event | None:
        """One step of a bank: on to the next, or the end."""
        is_taken = result is Result.OK
        self.counters.acknowledged += is_taken
        self.counters.refused += not is_taken
        if is_taken and not transfer.go_on(now_ns):
            return None
        self._transfer, self._outbox.holds_waveforms = None, False
        if not is_taken:
            return BankRefused(result)
        self.configuration = replace(self.configuration, bank=transfer.bank)
        self._waveforms = {}
        return BankReplaced()

    def _reported(self, status: Status, now_ns: int) -> Event:
        self.counters.statuses += 1
        self.status = status
        if self.state is LinkState.READY:
            self._patience_end_ns = now_ns + SILENCE_NS
            if status.state in (DeviceState.IDLE, DeviceState.LATCHED):
                self._end_session(LinkState.STOPPED)
        return StatusReceived(status, now_ns)

    def _faulted(self, fault: Fault, sequence: int) -> Event | None:
        self.counters.faults += 1
        self._replies.append(self._frame(Ack(fault.type_byte, sequence, Result.OK)))
        if self.state is LinkState.READY:
            # A fault of before, such as that of a pulled cable, repeats until its acknowledgement has come.
            if fault.device_time_us < self._arming_device_us:
                return None
            self._end_session(LinkState.STOPPED)
        return FaultReceived(fault.fault, fault.device_time_us)

    def _end_session(self, state: LinkState) -> None:
        self.state, self._patience_end_ns, self._transfer = state, None, None
        self._outbox.clear()


def _check_fit(hello: Hello, configuration: LinkConfiguration) -> None:
    if hello.version_major != VERSION_MAJOR:
        raise LinkError(
            f"the device speaks protocol {hello.version_major}.{hello.version_minor}, this host "
            f"{VERSION_MAJOR}.{VERSION_MINOR}: install the firmware that belongs to this version of tactable"
        )
    if hello.schema_hash != SCHEMA_HASH:
        raise LinkError(
            f"the device defines its messages otherwise (schema {hello.schema_hash:08x}, this host {SCHEMA_HASH:08x}): "
            "install the firmware that belongs to this version of tactable"
        )
    if hello.number_of_actuators < configuration.number_of_actuators:
        raise LinkError(
            f"the device drives {hello.number_of_actuators} actuators, {configuration.number_of_actuators} are needed: "
            "connect another device or choose a table for fewer actuators"
        )
    configuration.check_rate(hello.number_of_actuators)


def _check_bank(hello: Hello | Capabilities, size_bytes: int, longest_us: int) -> None:
    if Features.WAVEFORMS not in hello.features:
        raise LinkError("the device plays no waveforms: connect another device or configure no bank")
    if size_bytes > hello.bank_capacity_bytes:
        raise LinkError(
            f"the bank has {size_bytes} bytes, the device holds {hello.bank_capacity_bytes}: "
            "take fewer or shorter waveforms, or a lower sample rate"
        )
    if longest_us > hello.longest_waveform_ms * US_PER_MS:
        raise LinkError(
            f"a waveform of the bank lasts {longest_us / US_PER_MS:g} ms, the device plays at most "
            f"{hello.longest_waveform_ms}: shorten it"
        )
