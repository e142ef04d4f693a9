"""Host side of the wire without I/O: bytes and time in, events and bytes out.

Theory of operation
-------------------
A `Link` is one session after another with one device. It reads no clock and touches no port: the loop hands bytes and
times in and writes what comes out, so that every law of it is tested in virtual time.

    DISCONNECTED → GREETING → PREPARING → SYNCHRONISING → ARMING → READY → STOPPING → STOPPED
         connect    HELLO      basis held    16 round trips    ACK     stop()    ACK, or a fault

- GREETING repeats HELLO_REQ, since opening a port resets many boards. PREPARING transfers the basis, unless the device
  holds it already. SYNCHRONISING compares the clocks, since the device accepts a command only with its own time in it.
- READY sends the first that is due of: the command that waits, the renewal of what sounds, a step of a running basis
  transfer, a time request; and nothing while the write before still occupies the line (`Line`).
- Any fault, a STATUS of a device that is not armed, or an ACK of STOP ends the session: STOPPED. Silence for longer
  than patience, a refused ARM or a device that does not fit raise LinkError: DISCONNECTED. Only `connect` leaves
  these two states, and the link never calls it: whether a device that stopped may move again is not for it to decide.

Invariants:

- Nothing is sent but by `outgoing`. A loop that hangs renews nothing, and the device falls silent by itself; a
  heartbeat from another thread would keep a bar moving whose loop is dead.
- A command is dropped, and counted, in every state but READY. None waits across a session.
- What must arrive (HELLO_REQ, the basis, ARM, STOP) is repeated until it is answered; what is soon outdated (SET, PLAY,
  KEEPALIVE) is never repeated for its own sake: the latest wins.

The same concerns lie side by side on the host, in the emulated firmware and in the firmware:

| concern | firmware_link/host | firmware_link/emulator | firmware/core |
|---|---|---|---|
| bytes, time and deadlines | link | firmware | device |
| who may drive | handshake, link | session | session |
| what sounds | outbox | drive, channels | drive, channels |
| how long it may sound | outbox | lease | lease |
| the basis | memory | memory | memory, basis |
| samples of the accelerometer | sensing | sense | sense, stream |
| what the device says | link | reports | reports |
| clicks that play and fade | protocol/player | protocol/player | player |
| weights to samples | | protocol/basis | click, voice |
"""

from dataclasses import replace

from firmware_link.host.clock import NS_PER_S, DeviceClock, Exchange
from firmware_link.host.handshake import Handshake, check_basis
from firmware_link.host.line import Line, RepeatedRequest
from firmware_link.host.link_values import (
    Armed,
    BasisReplaced,
    Capabilities,
    Event,
    LinkConfiguration,
    LinkCounters,
    LinkState,
    Stopped,
)
from firmware_link.host.memory import Memory
from firmware_link.host.outbox import Outbox
from firmware_link.host.sensing import Sensing
from firmware_link.protocol import drive_words, messages
from firmware_link.protocol.basis import Basis, EncodedClick
from firmware_link.protocol.framing import FrameDecoder, FrameEncoder, FramingCounters, Signal
from firmware_link.protocol.layout import Message
from firmware_link.protocol.link_errors import LinkError, LinkLostError, MessageError

EXCHANGE_PERIOD_NS = 980_000_000  # 200 ppm of it widen the bounds of the clock by 0.2 ms (PROTOCOL.md)
SILENCE_NS = NS_PER_S  # a status comes every 100 ms: ten lost in a row are no accident
STOP_PATIENCE_NS = NS_PER_S
STOP_RETRY_NS = 20_000_000  # some round trips of a slow line (1 ms of USB, 2 of a UART); tried until STOP_PATIENCE_NS
_HANDSHAKING = (LinkState.GREETING, LinkState.PREPARING, LinkState.SYNCHRONISING, LinkState.ARMING)
# A global name costs less than an attribute of the enumeration, and READY is compared between a touch and its answer.
_READY = LinkState.READY


class Link:
    """One session with a device, owned by one loop.

    The loop calls `receive` with what came, `poll`, `outgoing` for what to write, and comes back no later than
    `next_deadline_ns`. Times are host monotonic nanoseconds; give `receive` a time taken after the read and `outgoing`
    one taken before the write, so that the clock bounds hold.
    """

    def __init__(self, configuration: LinkConfiguration) -> None:
        self.counters = LinkCounters()
        self.state = LinkState.DISCONNECTED
        self.clock = DeviceClock()
        self._decoder = FrameDecoder()
        self._encoder = FrameEncoder()
        self._patience_end_ns: int | None = None
        self.status: messages.Status | None = None  # the last STATUS of this session; None before the first
        self.acknowledgements = b""  # frames that acknowledge FAULTs, to be sent
        self.reconfigure(configuration)

    @property
    def capabilities(self) -> Capabilities | None:
        """Capabilities that the device announced; None until it is greeted."""
        return self._handshake.capabilities

    @property
    def framing_counters(self) -> FramingCounters:
        """Frames from the device, accepted and refused."""
        return self._decoder.counters

    @property
    def drive_sequence(self) -> int | None:
        """Sequence of the last SET or PLAY that brought a new command: STATUS names it once it is applied."""
        return self._outbox.drive_sequence

    def reconfigure(self, configuration: LinkConfiguration) -> None:
        """Take limits and basis from another configuration; `connect` must follow."""
        self.configuration = configuration
        self._line = Line(configuration.bit_rate_hz, self._encoder)
        self._handshake = Handshake(configuration, self._line, 0)
        self._request = RepeatedRequest(self._line, 0)  # of time in READY, to stop in STOPPING
        self._outbox = Outbox(self.counters, configuration.slew_limit_per_s, self._encoder)
        self._memory = Memory(configuration.basis, self._line, self._outbox)
        self._sensing = Sensing(self._line)

    def connect(self, now_ns: int) -> None:
        """Start a new session, whatever was before: greet, hand the basis over, compare clocks, arm."""
        self.state = LinkState.GREETING
        self.clock = DeviceClock()
        self._line.free_ns = now_ns
        self._handshake = Handshake(self.configuration, self._line, now_ns)
        self._outbox.start(b"", self.configuration.lease_ms, self.clock)
        self._memory.end_transfer()
        self._sensing.end()
        self.status, self.acknowledgements = None, b""
        self._extend_patience(now_ns)

    def set_drive(self, drive: bytes, *, writes_phase: bool = True) -> None:
        """Send this drive, from `encode_drive`, next; it replaces a command that waits. Dropped, counted unless READY.

        Without `writes_phase` what sounds runs on at the new frequencies, without a step. Actuators of the device
        beyond those of the drive get silence. Raises LinkError for a drive that is too long.
        """
        if self.state is _READY:
            self._outbox.put_drive(drive, writes_phase=writes_phase)
        else:
            self.counters.dropped += 1

    def set_play(self, click: EncodedClick) -> None:
        """Play a click next, in place of what sounds; silence follows. Otherwise as `set_drive`.

        Raises LinkError for a click that is not made of the basis of this link.
        """
        if self.state is _READY:
            self._memory.check(click)
            self._outbox.put(click)
        else:
            self.counters.dropped += 1

    def set_silent(self) -> None:
        """Ramp every actuator to zero and stay armed; sends nothing where all is silent already."""
        if not self._outbox.is_silent:
            self.set_drive(self._outbox.silent_drive)

    def replace_basis(self, basis: Basis) -> None:
        """Hand another basis over while the device plays clicks of the one it has.

        The event BasisReplaced or BasisRefused ends the transfer, and so does the end of the session, without an event.
        Clicks wait while the device changes over; a click of the old basis that still waits then is dropped. Raises
        LinkError unless READY, and for a basis that the device has no room for at all.
        """
        if self.state is not _READY or self.capabilities is None:
            raise LinkError("no basis is handed over before the device is armed: configure it, or wait")
        check_basis(self.capabilities, basis)
        self._memory.replace(basis)

    def start_sensing(self, now_ns: int) -> None:
        """Ask for the samples of the device's accelerometer, as events, until the session ends.

        Raises LinkError unless READY, and for a device without an accelerometer; `receive` raises it later where the
        line does not carry the samples.
        """
        if self.state is not _READY or self.capabilities is None:
            raise LinkError("no accelerometer is read before the device is armed: connect first")
        self._sensing.start(self.capabilities.features, now_ns)

    def stop(self, now_ns: int) -> None:
        """Ramp to zero and latch: STOP goes out before anything else, until it is acknowledged."""
        if self.state is not LinkState.DISCONNECTED:
            self._end_session(LinkState.STOPPING)
            self._request.due_ns = self._line.free_ns = now_ns
            self._patience_end_ns = now_ns + STOP_PATIENCE_NS

    def disconnect(self) -> None:
        """Forget the session, as after an unplug."""
        self._end_session(LinkState.DISCONNECTED)
        self.acknowledgements = b""

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """Take bytes in; raises LinkError when the device does not fit or refuses to arm."""
        events: list[Event] = []
        for item in self._decoder.receive(data):
            if isinstance(item, Signal) or self.state is LinkState.DISCONNECTED:
                continue
            try:
                sequence, message = messages.decode_body(item)
            except MessageError:
                self.counters.unexpected += 1
                continue
            try:
                event = self._act_on(message, sequence, now_ns)
            except LinkError:
                self.disconnect()
                raise
            if event is not None:
                events.append(event)
        return events

    def is_overdue(self, now_ns: int) -> bool:
        """Whether the device has been silent for longer than patience, as far as `receive` was told."""
        return self._patience_end_ns is not None and now_ns >= self._patience_end_ns

    def poll(self, now_ns: int) -> None:
        """Raises LinkLostError when the device has been silent for too long."""
        if not self.is_overdue(now_ns):
            return
        state = self.state
        self.disconnect()
        raise LinkLostError(
            f"no answer from the device while {state.value}: check that it is powered, that the port is the right one "
            "and that its firmware speaks this protocol, then connect again"
        )

    def outgoing(self, now_ns: int) -> bytes:
        """What to write now, at most one command; empty while the last write still occupies the line."""
        line = self._line
        if now_ns < line.free_ns:
            return b""
        frames = b""
        if self.state is _READY:
            frames = (
                self._outbox.next_frame(now_ns)
                or self._memory.next_frame(now_ns)
                or self._sensing.next_frame(now_ns)
                or self._request.next_frame(messages.TimeRequest(now_ns), EXCHANGE_PERIOD_NS, now_ns)
            )
        elif self.state is LinkState.STOPPING:
            frames = self._request.next_frame(messages.Stop(), STOP_RETRY_NS, now_ns)
        elif self.state in _HANDSHAKING:
            frames = self._handshake.next_frame(now_ns)
        if self.acknowledgements:
            frames += self.acknowledgements
            self.acknowledgements = b""
        if frames:
            line.free_ns = now_ns + line.occupied_ns(len(frames))
        return frames

    def next_deadline_ns(self) -> int | None:
        """When `outgoing` or `poll` has something to do without new bytes, perhaps in the past; None for never."""
        free_ns = send_ns = self._line.free_ns
        if self.state is _READY:
            send_ns = min(self._request.due_ns, self._outbox.due_ns(free_ns))
            if self._memory.due_ns is not None:
                send_ns = min(send_ns, self._memory.due_ns)
            if self._sensing.due_ns is not None:
                send_ns = min(send_ns, self._sensing.due_ns)
        elif self.state is LinkState.STOPPING:
            send_ns = self._request.due_ns
        elif self.state in _HANDSHAKING:
            send_ns = self._handshake.due_ns()
        elif not self.acknowledgements:
            return None
        deadline_ns = free_ns if self.acknowledgements else max(send_ns, free_ns)
        return deadline_ns if self._patience_end_ns is None else min(deadline_ns, self._patience_end_ns)

    def _act_on(self, message: Message, sequence: int, now_ns: int) -> Event | None:
        handshake = self._handshake
        match message:
            case messages.Hello() if self.state is LinkState.GREETING and handshake.is_answered_by(message):
                greeted = handshake.greeted(message, now_ns)
                self.state = handshake.state
                silent_drive = bytes(drive_words.DRIVE_SIZE * message.number_of_actuators)
                self._outbox.start(silent_drive, handshake.lease_ms, self.clock)
                return greeted
            case messages.Time() if handshake.is_timed_by(message, now_ns):
                times = (message.host_sent_ns, message.device_received_us, message.device_sent_us, now_ns)
                self.clock.update(Exchange(*times))
                if self.state is LinkState.SYNCHRONISING:
                    handshake.clock_compared(self.clock, now_ns)
                    self.state = handshake.state
                return None
            case messages.Ack():
                return self._acknowledged(message, now_ns)
            case messages.Status() | messages.Fault() | messages.Log():
                return self._reported(message, sequence, now_ns)
            case messages.Accelerometer() if self._sensing.is_wanted and self.capabilities is not None:
                actuators = self.capabilities.number_of_actuators
                return self._sensing.described(message, self.configuration.bit_rate_hz, actuators, now_ns)
            case messages.Acceleration() if self._sensing.is_wanted:
                return message
        self.counters.unexpected += 1
        return None

    def _acknowledged(self, ack: messages.Ack, now_ns: int) -> Event | None:
        is_accepted = ack.result is messages.Result.OK
        self.counters.acknowledged += is_accepted
        self.counters.refused += not is_accepted
        if self._memory.is_answered_by(ack):
            event = self._memory.acknowledged(ack.result, now_ns)
            if isinstance(event, BasisReplaced):
                self.configuration = replace(self.configuration, basis=self._memory.basis)
            return event
        if self.state in _HANDSHAKING and self._handshake.acknowledged(ack, now_ns):
            self.state = self._handshake.state
            if self.state is _READY:
                self._request.due_ns = now_ns + EXCHANGE_PERIOD_NS
                self._outbox.lease.renewal_due_ns = now_ns
                self._patience_end_ns = now_ns + SILENCE_NS
                return Armed()
            # A long basis on a slow line takes longer than the patience; each answer shows that it goes on.
            self._extend_patience(now_ns)
        elif is_accepted and (self.state, ack.acknowledged_type) == (LinkState.STOPPING, messages.Stop.type_byte):
            self._end_session(LinkState.STOPPED)
            return Stopped()
        return None

    def _reported(
        self, message: messages.Status | messages.Fault | messages.Log, sequence: int, now_ns: int
    ) -> Event | None:
        is_ready = self.state is _READY
        match message:
            case messages.Status():
                self.counters.statuses += 1
                self.status = message
                if is_ready:
                    self._patience_end_ns = now_ns + SILENCE_NS
                    if message.state in (messages.DeviceState.IDLE, messages.DeviceState.LATCHED):
                        self._end_session(LinkState.STOPPED)
            case messages.Fault():
                self.counters.faults += 1
                ack = messages.Ack(message.type_byte, sequence, messages.Result.OK)
                self.acknowledgements += self._encoder.encode(ack)
                # A fault of before, such as that of a pulled cable, repeats until its acknowledgement has come.
                if is_ready and message.device_time_us < self._handshake.arming_device_us:
                    return None
                if is_ready:
                    self._end_session(LinkState.STOPPED)
            case messages.Log():
                self.counters.logs += 1
        return message

    def _extend_patience(self, now_ns: int) -> None:
        self._patience_end_ns = now_ns + int(self.configuration.handshake_timeout_s * NS_PER_S)

    def _end_session(self, state: LinkState) -> None:
        self.state, self._patience_end_ns = state, None
        self._memory.end_transfer()
        self._sensing.end()
        self._outbox.clear()
