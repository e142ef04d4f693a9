"""Handshake from an open port to an armed device: greet, hand the basis over, compare the clocks, arm."""

from firmware_link.host.clock import DeviceClock
from firmware_link.host.line import Line, RepeatedRequest
from firmware_link.host.link_values import Capabilities, Greeted, LinkConfiguration, LinkState
from firmware_link.host.memory import RETRY_NS, BasisTransfer
from firmware_link.protocol import messages
from firmware_link.protocol.basis import Basis, check_actuators
from firmware_link.protocol.framing import DELIMITER
from firmware_link.protocol.link_errors import LinkError, LinkLostError

US_PER_MS = 1_000
FIRST_EXCHANGES = 16
# A device that was rebooted or latched since it was greeted answers with these.
_FORGOTTEN = (messages.Result.WRONG_BOOT, messages.Result.WRONG_STATE)


class Handshake:
    """The states GREETING, PREPARING, SYNCHRONISING, ARMING and READY of one session, each with its repeated request.

    A new handshake begins with every `Link.connect`, so that nothing of the session before leaks into it: an answer
    to an earlier greeting or time request is recognised by its nonce or its time, and ignored. What the device answers
    raises LinkError where the device does not fit or refuses; then the handshake is over.
    """

    def __init__(self, configuration: LinkConfiguration, line: Line, now_ns: int) -> None:
        self.state = LinkState.GREETING
        self.capabilities: Capabilities | None = None  # what the device said of itself, once it has answered
        self.lease_ms = configuration.lease_ms  # once the device has answered: the shorter of what both sides allow
        self.arming_device_us = 0  # when the host began to arm: a fault before it is of an earlier session
        self._configuration, self._line = configuration, line
        self._connected_ns = now_ns
        self._request = RepeatedRequest(line, now_ns)
        self._greeting = messages.HelloRequest(
            messages.MAGIC, messages.VERSION_MAJOR, messages.VERSION_MINOR, now_ns % 2**32
        )
        self._arm: messages.Arm | None = None
        self._transfer: BasisTransfer | None = None

    def due_ns(self) -> int:
        """Time at which `next_frame` has one, perhaps in the past."""
        return self._request.due_ns if self._transfer is None else self._transfer.due_ns

    def next_frame(self, now_ns: int) -> bytes:
        """The request of the state, where it is due; empty otherwise."""
        if self._transfer is not None:
            return self._transfer.next_frame(now_ns)
        if self.state is LinkState.GREETING:
            # The leading delimiter parts the frame from what a boot loader or modem left on the line.
            return self._request.next_frame(self._greeting, RETRY_NS, now_ns, before=DELIMITER)
        if self.state is LinkState.ARMING and self._arm is not None:
            return self._request.next_frame(self._arm, RETRY_NS, now_ns)
        return self._request.next_frame(messages.TimeRequest(now_ns), RETRY_NS, now_ns)

    def is_answered_by(self, hello: messages.Hello) -> bool:
        """Whether a HELLO answers this session's greeting."""
        return hello.nonce == self._greeting.nonce

    def greeted(self, hello: messages.Hello, now_ns: int) -> Greeted:
        """Take the answer to the greeting: hand the basis over next, if there is one that the device does not hold."""
        configuration, number_of_actuators = self._configuration, hello.number_of_actuators
        _check_fit(hello, configuration)
        capabilities, basis = Capabilities.from_hello(hello), configuration.basis
        if basis is not None:
            check_basis(capabilities, basis)
        self.capabilities = capabilities
        self.lease_ms = min(configuration.lease_ms, hello.longest_lease_ms)
        self._arm = configuration.arm_for(hello.boot_id, number_of_actuators, self.lease_ms)
        if basis is None or hello.held_basis_hash == basis.hash:
            self._synchronise(now_ns)
        else:
            self.state = LinkState.PREPARING
            self._transfer = BasisTransfer(basis, self._line)
        return Greeted(capabilities)

    def is_timed_by(self, time: messages.Time, now_ns: int) -> bool:
        """Whether a TIME answers a request of this session."""
        return self._connected_ns <= time.host_sent_ns <= now_ns

    def clock_compared(self, clock: DeviceClock, now_ns: int) -> None:
        """Another exchange of times is in the clock: ask for the next, or arm."""
        self._request.due_ns = now_ns
        if clock.exchanges >= FIRST_EXCHANGES:
            self.state = LinkState.ARMING
            self.arming_device_us = clock.device_time_us(now_ns)

    def acknowledged(self, ack: messages.Ack, now_ns: int) -> bool:
        """Take the answer to a step of the basis or to ARM; False for any other."""
        if self._transfer is not None and self._transfer.is_answered_by(ack):
            _check_accepted(ack, "take the basis", "it")
            if self._transfer.accept_step(now_ns):
                self._transfer = None
                self._synchronise(now_ns)
            return True
        if (self.state, ack.acknowledged_type) != (LinkState.ARMING, messages.Arm.type_byte):
            return False
        _check_accepted(ack, "arm", "the limits")
        self.state = LinkState.READY
        return True

    def _synchronise(self, now_ns: int) -> None:
        self.state = LinkState.SYNCHRONISING
        self._request.due_ns = now_ns


def check_basis(capabilities: Capabilities, basis: Basis) -> None:
    """Raises LinkError for a basis that the device cannot hold or play, MessageError for one of more actuators."""
    if messages.Features.WAVEFORMS not in capabilities.features:
        raise LinkError("the device plays no clicks: connect another device or configure no basis")
    check_actuators(basis, capabilities.number_of_actuators)
    if len(basis.data) > capabilities.basis_capacity_bytes:
        raise LinkError(
            f"the basis has {len(basis.data)} bytes, the device holds {capabilities.basis_capacity_bytes}: "
            "take fewer or shorter sets of functions, or a lower sample rate"
        )
    longest_us = max(map(basis.length_us, range(len(basis.sets))))
    if longest_us > capabilities.longest_waveform_ms * US_PER_MS:
        raise LinkError(
            f"a click of the basis lasts {longest_us / US_PER_MS:g} ms, the device plays at most "
            f"{capabilities.longest_waveform_ms}: shorten it"
        )


def _check_fit(hello: messages.Hello, configuration: LinkConfiguration) -> None:
    if hello.version_major != messages.VERSION_MAJOR:
        raise LinkError(
            f"the device speaks protocol {hello.version_major}.{hello.version_minor}, this host "
            f"{messages.VERSION_MAJOR}.{messages.VERSION_MINOR}: install the firmware that belongs to this version of "
            "tactable"
        )
    if hello.schema_hash != messages.SCHEMA_HASH:
        raise LinkError(
            f"the device defines its messages otherwise (schema {hello.schema_hash:08x}, this host "
            f"{messages.SCHEMA_HASH:08x}): install the firmware that belongs to this version of tactable"
        )
    if hello.number_of_actuators < configuration.number_of_actuators:
        raise LinkError(
            f"the device drives {hello.number_of_actuators} actuators, {configuration.number_of_actuators} are needed: "
            "connect another device or choose a table for fewer actuators"
        )
    if hello.longest_lease_ms == 0:
        raise LinkError(
            "the device allows no lease, so no drive would sound: set longest_lease_ms of its firmware to 1 to 100, "
            "and flash it again"
        )


def _check_accepted(ack: messages.Ack, request: str, remedy: str) -> None:
    if ack.result is not messages.Result.OK:
        refusal = LinkLostError if ack.result in _FORGOTTEN else LinkError
        raise refusal(f"the device refused to {request} ({ack.result.name}): connect again, or correct {remedy}")
