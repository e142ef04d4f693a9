"""A session with an emulated device on a virtual line."""

from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.link import Link
from firmware_link.host.link_values import Event, LinkConfiguration, LinkState
from firmware_link.host.session import Session
from firmware_link.protocol.framing import FrameDecoder
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import CLOCK_REFERENCE_SPAN, CLOCK_REFERENCE_US, decode_body
from tests.tools.virtual import MS, VirtualClock, VirtualLine

BOOT_ID = 0x5EED
STEP_NS = 250_000


@dataclass
class VirtualRig:
    """A session that is served each STEP_NS; the device's clock starts `device_start_ns` late."""

    link_configuration: LinkConfiguration = field(default_factory=lambda: LinkConfiguration(2, bit_rate_hz=1_000_000))
    device_configuration: DeviceConfiguration = field(default_factory=lambda: DeviceConfiguration(BOOT_ID))
    delay_ns: int = 300_000
    drop_every: int = 0
    device_start_ns: int = 7_000_000_123
    faults: str = ""

    def __post_init__(self) -> None:
        self.line = VirtualLine(
            self.device_configuration,
            self.faults,
            delay_ns=self.delay_ns,
            booted_ns=self.device_start_ns,
            clock=VirtualClock(self.device_start_ns + 5 * MS),
            loses=self.loses,
        )
        self.session = Session(Link(self.link_configuration), self.line, self.line.now_ns)
        self.link = self.session.link
        self.events: list[Event] = []
        self.is_host_alive = True
        self.losing = 0

    @property
    def now_ns(self) -> int:
        return self.line.time_ns

    @property
    def firmware(self) -> EmulatedFirmware:
        return self.line.firmware  # type: ignore[no-any-return]  # this line's device

    def loses(self, number: int) -> bool:
        """Whether the device never gets this write."""
        self.losing -= (is_lost := self.losing > 0)
        return is_lost or bool(self.drop_every and number % self.drop_every == 0)

    def run(self, duration_ns: int) -> None:
        end_ns = self.now_ns + duration_ns
        while self.now_ns < end_ns:
            self.step()

    def run_until(self, condition: Callable[[], bool], limit_ns: int = 10_000 * MS) -> None:
        end_ns = self.now_ns + limit_ns
        while not condition():
            assert self.now_ns < end_ns
            self.step()

    def connect(self) -> None:
        self.session.connect()
        self.run_until(lambda: self.link.state is LinkState.READY)

    def step(self) -> None:
        self.line.clock.run_to(self.now_ns + STEP_NS)
        if self.is_host_alive:
            self.events += self.session.receive()
            due_ns, number = self.link.next_deadline_ns(), len(self.line.written)
            self.session.send()
            assert len(self.line.written) == number or (due_ns is not None and due_ns <= self.now_ns)


def decode_messages(data: bytes) -> list[Message]:
    return [decode_body(item)[1] for item in FrameDecoder().receive(data) if isinstance(item, bytes)]


def reference(device_us: int) -> int:
    return device_us // CLOCK_REFERENCE_US % CLOCK_REFERENCE_SPAN
