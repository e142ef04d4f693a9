"""Both ends of a bench without a driver: the engine's source of touches on a socket, and a far end of its link.

The far end is light enough for any rate: it notes when each command came, and keeps the session going.
"""

import os
import struct
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from engine.touch.sources import OnClock
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.serial_port import READ_SIZE
from firmware_link.protocol.framing import DELIMITER
from firmware_link.protocol.messages import Play, Set

STAMPS = struct.Struct("<qq")  # leads each report on its socket: when it was due, and when it was sent, ns
_NS_PER_US = 1_000
_MS = 1_000_000
# The emulated firmware takes 30 us for a frame, which would compete with what is measured. So it gets a SET only this
# often: before 127 sequences have passed, beyond which it could not order them, and before the lease ends.
_SHOWN_EACH_NS = 10 * _MS
# COBS moves only zeros: type and sequence lie here as they are, unless the first zero comes before them.
_TYPE_AT, _SEQUENCE_AT = 1, 2
_CODES = struct.Struct("<BBB")


class SocketSource(OnClock):
    """Reports from one end of a pair of SOCK_SEQPACKET, as a Source whose time is when each report was due.

    `sent_ns` and `read_ns` hold when each of at most `capacity` reports was sent and read.
    """

    def __init__(
        self,
        descriptor_of_socket: int,
        descriptor: bytes,
        numbers: tuple[int, int],
        capacity: int,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.name, self.descriptor = "bench", descriptor
        self.vendor_id, self.product_id = numbers
        self.ended = False
        self.sent_ns = array("q", bytes(8 * capacity))
        self.read_ns = array("q", bytes(8 * capacity))
        self._socket, self._monotonic_ns = descriptor_of_socket, monotonic_ns
        os.set_blocking(descriptor_of_socket, False)

    def fileno(self) -> int:
        """The socket."""
        return self._socket

    def next_time_ns(self) -> None:
        """Unknown: only the load generator has the schedule."""

    def read(self, now_ns: int) -> bytes | None:  # noqa: ARG002  # a Source
        """The next report; the other end's close ends the source."""
        try:
            packet = os.read(self._socket, READ_SIZE)
        except BlockingIOError:
            return None
        if not packet:
            self.ended = True
            return None
        return self.take_packet(packet, self._monotonic_ns(), is_last=False)

    packet_head = STAMPS.size

    packet_fileno = fileno

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:  # noqa: ARG002  # a PacketSource
        """The report in a packet that was read at `now_ns`."""
        self.report_index += 1
        self.read_ns[self.report_index] = now_ns
        self.report_time_ns, self.sent_ns[self.report_index] = STAMPS.unpack_from(packet)
        return packet[STAMPS.size :]


@dataclass
class Arrivals:
    """Arrival of each SET and PLAY, ns, and its sequence number."""

    time_ns: "array[int]" = field(default_factory=lambda: array("q"))
    sequence: "array[int]" = field(default_factory=lambda: array("B"))


class LightDevice:
    """An emulated firmware that is shown everything but most of the SETs. SIMULATED."""

    def __init__(self, configuration: DeviceConfiguration, now_ns: int) -> None:
        self.arrivals = Arrivals()
        self._firmware = EmulatedFirmware(replace(configuration, boot_id=now_ns % 2**32))
        self._zero_ns = now_ns
        self._shown_ns = now_ns
        self._rest = b""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes in; the answer."""
        *frames, self._rest = (self._rest + data).split(DELIMITER)
        shown = [frame for frame in frames if not self._note(frame, now_ns)]
        if not shown:
            return b""
        return self._firmware.receive(DELIMITER.join([*shown, b""]), self._us(now_ns))

    def run_until(self, now_ns: int) -> bytes:
        """Let time pass; the bytes that it sends by itself until now, such as a STATUS."""
        return self._firmware.run_until(self._us(now_ns))

    def next_deadline_ns(self) -> int | None:
        """Time at which it sends by itself next; None while it waits."""
        deadline_us = self._firmware.next_deadline_us()
        return None if deadline_us is None else self._zero_ns + deadline_us * _NS_PER_US

    def _note(self, frame: bytes, now_ns: int) -> bool:
        """Note a SET or PLAY; whether the firmware need not see it."""
        if len(frame) <= _SEQUENCE_AT:
            return False
        code, type_byte, sequence = _CODES.unpack_from(frame)
        if code <= _TYPE_AT or type_byte not in (Set.type_byte, Play.type_byte):
            return False
        self.arrivals.time_ns.append(now_ns)
        self.arrivals.sequence.append(sequence if code > _SEQUENCE_AT else 0)
        if type_byte == Set.type_byte and now_ns - self._shown_ns < _SHOWN_EACH_NS:
            return True
        self._shown_ns = now_ns
        return False

    def _us(self, now_ns: int) -> int:
        return (now_ns - self._zero_ns) // _NS_PER_US
