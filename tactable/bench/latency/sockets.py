"""The engine's ends of two socket pairs, in place of a digitizer and a serial port and without a driver."""

import os
import struct
import time
from array import array

from firmware_link.protocol.errors import LinkLostError

STAMPS = struct.Struct("<qq")
"""Leads each report on its socket: when it was due, and when it was sent, ns."""
_READ_SIZE = 4096


class SocketSource:
    """Reports from one end of a pair of SOCK_SEQPACKET, as a Source whose time is when each report was due.

    `sent_ns` and `read_ns` hold when each of at most `capacity` reports was sent and read.
    """

    def __init__(
        self, descriptor_of_socket: int, name: str, descriptor: bytes, numbers: tuple[int, int], capacity: int
    ):
        self.name, self.descriptor = name, descriptor
        self.vendor_id, self.product_id = numbers
        self.ended = False
        self.report_index = -1
        self.report_time_ns = 0
        self.sent_ns = array("q", bytes(8 * capacity))
        self.read_ns = array("q", bytes(8 * capacity))
        self._socket = descriptor_of_socket
        os.set_blocking(descriptor_of_socket, False)

    def fileno(self) -> int:
        """The socket."""
        return self._socket

    def next_time_ns(self) -> None:
        """Unknown: only the load generator has the schedule."""

    def read(self, now_ns: int) -> bytes | None:  # noqa: ARG002  # a Source
        """The next report; the other end's close ends the source."""
        try:
            packet = os.read(self._socket, _READ_SIZE)
        except BlockingIOError:
            return None
        if not packet:
            self.ended = True
            return None
        return self.take_packet(packet, time.monotonic_ns(), is_last=False)

    packet_head = STAMPS.size

    def packet_fileno(self) -> int:
        """The socket."""
        return self._socket

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:  # noqa: ARG002  # a PacketSource
        """The report in a packet that was read at `now_ns`."""
        self.report_index += 1
        self.read_ns[self.report_index] = now_ns
        self.report_time_ns, self.sent_ns[self.report_index] = STAMPS.unpack_from(packet)
        return packet[STAMPS.size :]

    def source_time_ns(self, now_ns: int) -> int:
        """The clock's own."""
        return now_ns

    def clock_time_ns(self, source_time_ns: int) -> int:
        """The clock's own."""
        return source_time_ns


class SocketPort:
    """One end of a pair of sockets as a port."""

    def __init__(self, descriptor: int) -> None:
        self._socket = descriptor
        os.set_blocking(descriptor, False)

    def fileno(self) -> int:
        """The socket."""
        return self._socket

    def read(self) -> bytes:
        """What has come; raises LinkLostError when the other end has closed."""
        try:
            data = os.read(self._socket, _READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkLostError(f"the socket is gone ({error}): start the measurement again") from error
        if not data:
            raise LinkLostError("the other end of the socket has closed: start the measurement again")
        return data

    def write(self, data: bytes) -> int:
        """Number of bytes taken; raises LinkLostError when the other end has closed."""
        try:
            return os.write(self._socket, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise LinkLostError(f"the socket is gone ({error}): start the measurement again") from error
