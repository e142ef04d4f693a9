"""The engine's ends of two socket pairs, in place of a digitizer and a serial port and without a driver."""

import os
import struct
import time
from array import array
from collections.abc import Callable

from engine.touch.sources import OnClock
from firmware_link.host.serial_port import READ_SIZE

STAMPS = struct.Struct("<qq")  # leads each report on its socket: when it was due, and when it was sent, ns


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
