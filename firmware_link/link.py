"""Host side of the wire without I/O: bytes and time in, events and bytes out."""

from collections.abc import Callable

from firmware_link.clock import NS_PER_S, DeviceClock, Exchange
from firmware_link.errors import LinkError, MessageError
from firmware_link.framing import DELIMITER, FrameDecoder, FramingCounters, Signal, encode_message
from firmware_link.layout import Message
from firmware_link.link_values import (
    Armed,
    Capabilities,
    Event,
    FaultReceived,
    Greeted,
    LinkConfiguration,
    LinkCounters,
    LinkState,
    StatusReceived,
    Stopped,
)
from firmware_link.messages import (
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
    Hello,
    HelloRequest,
    Result,
    Set,
    SetFlag,
    Status,
    Stop,
    Time,
    TimeRequest,
    decode_body,
    encode_amplitude,
)

NS_PER_MS = 1_000_000
# A start bit, eight of data, a stop bit.
WIRE_BITS_PER_BYTE = 10
RETRY_NS = 100 * NS_PER_MS
STOP_RETRY_NS = 20 * NS_PER_MS
STOP_PATIENCE_NS = NS_PER_S
# A status comes every 100 ms: ten lost in a row are no accident.
SILENCE_NS = NS_PER_S
FIRST_EXCHANGES = 16
EXCHANGE_PERIOD_NS = 980 * NS_PER_MS
# The device disarms 250 ms after the last fresh frame: two in a row may be lost.
SILENT_RENEWAL_NS = 80 * NS_PER_MS
RENEWALS_PER_LEASE = 3


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
        self._replies: list[bytes] = []
        self._mailbox: bytes | None = None
        self._silent_drive = b""
        self._drive = b""
        self._due_ns = 0
        self._renewal_due_ns = 0
        self._patience_end_ns: int | None = None
        self._line_free_ns = 0
        self._connected_ns = 0

    @property
    def framing_counters(self) -> FramingCounters:
        """Frames from the device, accepted and refused."""
        return self._decoder.counters

    def connect(self, now_ns: int) -> None:
        """Start a new session, whatever was before; it greets, compares clocks and arms."""
        self.state = LinkState.GREETING
        self.capabilities, self.status, self.drive_sequence = None, None, None
        self.clock = DeviceClock()
        self._nonce = now_ns % 2**32
        self._replies, self._mailbox, self._drive = [], None, b""
        self._connected_ns = self._due_ns = self._line_free_ns = now_ns
        self._patience_end_ns = now_ns + int(self.configuration.handshake_timeout_s * NS_PER_S)

    def set_drive(self, drive: bytes) -> None:
        """Drive this next, from `encode_drive`; replaces one not sent yet. Dropped and counted unless READY.

        The device gets silence on actuators beyond those of the drive; raises LinkError for a drive too long.
        """
        if self.state is not LinkState.READY:
            self.counters.dropped += 1
            return
        if len(drive) > len(self._silent_drive):
            raise LinkError(f"a drive of {len(drive)} bytes; the device takes {len(self._silent_drive)}")
        self.counters.coalesced += self._mailbox is not None
        self._mailbox = drive.ljust(len(self._silent_drive), b"\0")

    def set_silent(self) -> None:
        """Ramp every actuator to zero and stay armed; nothing to send where all is silent already."""
        if self._mailbox is not None or any(self._drive):
            self.set_drive(self._silent_drive)

    def stop(self, now_ns: int) -> None:
        """Ramp to zero and latch: STOP goes out before anything else, until it is acknowledged."""
        self._mailbox, self._drive = None, b""
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
        """Raises LinkError when the device has been silent for too long."""
        if self._patience_end_ns is None or now_ns < self._patience_end_ns:
            return
        state = self.state
        self.disconnect()
        raise LinkError(
            f"no answer from the device while {state.value}: check that it is powered, that the port is the right one "
            "and that its firmware speaks this protocol, then connect again"
        )

    def outgoing(self, now_ns: int) -> bytes:
        """What to write now, at most one SET; nothing while the last write still occupies the line."""
        if now_ns < self._line_free_ns:
            return b""
        frames = self._next_frame(now_ns) + b"".join(self._replies)
        self._replies = []
        self._line_free_ns = now_ns + len(frames) * WIRE_BITS_PER_BYTE * NS_PER_S // self.configuration.bit_rate_hz
        return frames

    def next_deadline_ns(self) -> int | None:
        """When `outgoing` or `poll` has something to do without new bytes, perhaps in the past; None for never."""
        if self.state is LinkState.DISCONNECTED:
            return None
        send_ns = [] if self.state is LinkState.STOPPED else [self._due_ns]
        if self.state is LinkState.READY:
            send_ns.append(self._renewal_due_ns)
        if self._replies or self._mailbox is not None:
            send_ns.append(self._line_free_ns)
        deadlines_ns = [max(min(send_ns), self._line_free_ns)] if send_ns else []
        if self._patience_end_ns is not None:
            deadlines_ns.append(self._patience_end_ns)
        return min(deadlines_ns, default=None)

    def _next_frame(self, now_ns: int) -> bytes:
        match self.state:
            case LinkState.GREETING:
                return self._repeat(self._hello_request, RETRY_NS, now_ns)
            case LinkState.SYNCHRONISING:
                return self._repeat(self._time_request, RETRY_NS, now_ns)
            case LinkState.ARMING:
                return self._repeat(self._arm_request, RETRY_NS, now_ns)
            case LinkState.READY:
                return self._drive_frame(now_ns) or self._repeat(self._time_request, EXCHANGE_PERIOD_NS, now_ns)
            case LinkState.STOPPING:
                return self._repeat(lambda _: self._frame(Stop()), STOP_RETRY_NS, now_ns)
        return b""

    def _repeat(self, frame: Callable[[int], bytes], period_ns: int, now_ns: int) -> bytes:
        if now_ns < self._due_ns:
            return b""
        self._due_ns = now_ns + period_ns
        return frame(now_ns)

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
        if self._mailbox is not None:
            self._drive, self._mailbox = self._mailbox, None
            self.counters.sent += 1
            frame = self._set_frame(now_ns)
            self.drive_sequence = self._sequence
            return frame
        if now_ns < self._renewal_due_ns:
            return b""
        self.counters.renewed += 1
        return self._set_frame(now_ns)

    def _set_frame(self, now_ns: int) -> bytes:
        # Silence is renewed by SET too: had the SET that silenced been lost, anything else might hold the old drive.
        lease_ns = self._lease_ms * NS_PER_MS
        self._renewal_due_ns = now_ns + (lease_ns // RENEWALS_PER_LEASE if any(self._drive) else SILENT_RENEWAL_NS)
        return self._frame(Set(self._clock_reference(now_ns), SetFlag.WRITE_PHASE, self._lease_ms, self._drive))

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
        self.counters.unexpected += 1
        return None

    def _greeted(self, hello: Hello, now_ns: int) -> Event:
        try:
            _check_fit(hello, self.configuration.number_of_actuators)
        except LinkError:
            self.disconnect()
            raise
        self.capabilities = Capabilities.from_hello(hello)
        self._drive = self._silent_drive = bytes(DRIVE_SIZE * hello.number_of_actuators)
        unused = (0,) * (hello.number_of_actuators - len(self._amplitude_limits))
        self._lease_ms = min(self.configuration.lease_ms, hello.longest_lease_ms)
        limits = self._amplitude_limits + unused
        self._arm = Arm(hello.boot_id, self.configuration.slew_limit_per_s, self._lease_ms, limits)
        self.state, self._due_ns = LinkState.SYNCHRONISING, now_ns
        return Greeted(self.capabilities)

    def _compare_clocks(self, time: Time, now_ns: int) -> None:
        self.clock.update(Exchange(time.host_sent_ns, time.device_received_us, time.device_sent_us, now_ns))
        if self.state is LinkState.SYNCHRONISING:
            self._due_ns = now_ns
            if self.clock.exchanges >= FIRST_EXCHANGES:
                self.state = LinkState.ARMING

    def _acknowledged(self, ack: Ack, now_ns: int) -> Event | None:
        answer = (self.state, ack.acknowledged_type)
        if ack.result is not Result.OK:
            self.counters.refused += 1
            if answer != (LinkState.ARMING, Arm.type_byte):
                return None
            self.disconnect()
            raise LinkError(f"the device refused to arm ({ack.result.name}): connect again, or correct the limits")
        self.counters.acknowledged += 1
        if answer == (LinkState.ARMING, Arm.type_byte):
            self.state = LinkState.READY
            self._due_ns, self._renewal_due_ns = now_ns + EXCHANGE_PERIOD_NS, now_ns
            self._patience_end_ns = now_ns + SILENCE_NS
            return Armed()
        if answer == (LinkState.STOPPING, Stop.type_byte):
            self._end_session(LinkState.STOPPED)
            return Stopped()
        return None

    def _reported(self, status: Status, now_ns: int) -> Event:
        self.counters.statuses += 1
        self.status = status
        if self.state is LinkState.READY:
            self._patience_end_ns = now_ns + SILENCE_NS
            if status.state in (DeviceState.IDLE, DeviceState.LATCHED):
                self._end_session(LinkState.STOPPED)
        return StatusReceived(status, now_ns)

    def _faulted(self, fault: Fault, sequence: int) -> Event:
        self.counters.faults += 1
        self._replies.append(self._frame(Ack(fault.type_byte, sequence, Result.OK)))
        if self.state is LinkState.READY:
            self._end_session(LinkState.STOPPED)
        return FaultReceived(fault.fault, fault.device_time_us)

    def _end_session(self, state: LinkState) -> None:
        self.state = state
        self._mailbox, self._drive, self._patience_end_ns = None, b"", None


def _check_fit(hello: Hello, number_of_actuators: int) -> None:
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
    if hello.number_of_actuators < number_of_actuators:
        raise LinkError(
            f"the device drives {hello.number_of_actuators} actuators, {number_of_actuators} are needed: "
            "connect another device or choose a table for fewer actuators"
        )
