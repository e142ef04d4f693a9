"""A link and an emulated firmware in one process, joined by a line with virtual time and faults."""

from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_link.emulator import DeviceConfiguration, EmulatedFirmware
from firmware_link.host.link import Link
from firmware_link.host.link_values import Event, LinkConfiguration, LinkState
from firmware_link.protocol.framing import FrameDecoder, encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import (
    CLOCK_REFERENCE_SPAN,
    CLOCK_REFERENCE_US,
    MAGIC,
    VERSION_MAJOR,
    VERSION_MINOR,
    Arm,
    HelloRequest,
    Set,
    SetFlag,
    decode_body,
)

BOOT_ID = 0x5EED
STEP_NS = 250_000
MS = 1_000_000


@dataclass
class VirtualRig:
    """Whole milliseconds of session in microseconds of test; the device's clock starts `device_start_ns` late."""

    link_configuration: LinkConfiguration = field(default_factory=lambda: LinkConfiguration(2, bit_rate_hz=1_000_000))
    device_configuration: DeviceConfiguration = field(default_factory=lambda: DeviceConfiguration(BOOT_ID))
    delay_ns: int = 300_000
    drop_every: int = 0
    device_start_ns: int = 7_000_000_123

    def __post_init__(self) -> None:
        self.link = Link(self.link_configuration)
        self.firmware = EmulatedFirmware(self.device_configuration)
        self.now_ns = self.device_start_ns + 5_000_000
        self.events: list[Event] = []
        self.written: list[tuple[int, bytes]] = []
        self.is_host_alive = True
        self.losing = 0
        self._to_device: list[tuple[int, bytes]] = []
        self._to_host: list[tuple[int, bytes]] = []
        self._writes = 0

    def device_us(self) -> int:
        return (self.now_ns - self.device_start_ns) // 1000

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
        self.link.connect(self.now_ns)
        self.run_until(lambda: self.link.state is LinkState.READY)

    def reboot(self, boot_id: int) -> None:
        self.firmware = EmulatedFirmware(DeviceConfiguration(boot_id))
        self.device_start_ns = self.now_ns

    def step(self) -> None:
        self.now_ns += STEP_NS
        for data in self._arrived(self._to_device):
            self._answer(self.firmware.receive(data, self.device_us()))
        self._answer(self.firmware.advance(self.device_us()))
        if not self.is_host_alive:
            return
        for data in self._arrived(self._to_host):
            self.events += self.link.receive(data, self.now_ns)
        self.link.poll(self.now_ns)
        deadline_ns = self.link.next_deadline_ns()
        data = self.link.outgoing(self.now_ns)
        if data:
            assert deadline_ns is not None
            assert deadline_ns <= self.now_ns
            self._write(data)

    def _write(self, data: bytes) -> None:
        self.written.append((self.now_ns, data))
        self._writes += 1
        if self.losing:
            self.losing -= 1
        elif not self.drop_every or self._writes % self.drop_every:
            self._to_device.append((self.now_ns + self.delay_ns, data))

    def _answer(self, data: bytes) -> None:
        if data:
            self._to_host.append((self.now_ns + self.delay_ns, data))

    def _arrived(self, line: list[tuple[int, bytes]]) -> list[bytes]:
        arrived = [data for time_ns, data in line if time_ns <= self.now_ns]
        del line[: len(arrived)]
        return arrived


@dataclass
class BareHost:
    """Speaks to a firmware frame by frame, as a test wants it; times are device microseconds."""

    firmware: EmulatedFirmware = field(default_factory=lambda: EmulatedFirmware(DeviceConfiguration(BOOT_ID)))
    sequence: int = 0

    def send(self, message: Message, now_us: int) -> bytes:
        self.sequence = (self.sequence + 1) % 256
        return self.firmware.receive(encode_message(message, self.sequence), now_us)

    def arm(
        self, now_us: int, boot_id: int = BOOT_ID, lease_ms: int = 40, limit: int = 65_535, slew: int = 200
    ) -> None:
        self.send(HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 1), now_us)
        self.send(Arm(boot_id, slew, lease_ms, 0, (limit, limit)), now_us)

    def set(self, drive: bytes, now_us: int, lease_ms: int = 40, age_us: int = 0) -> bytes:
        return self.send(Set(reference(now_us - age_us), SetFlag.WRITE_PHASE, lease_ms, drive), now_us)


def decode_messages(data: bytes) -> list[Message]:
    return [decode_body(item)[1] for item in FrameDecoder().receive(data) if isinstance(item, bytes)]


def reference(device_us: int) -> int:
    return device_us // CLOCK_REFERENCE_US % CLOCK_REFERENCE_SPAN
