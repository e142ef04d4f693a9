"""Capacity of a line: how long a write occupies a transport, and the commands a second that it carries."""

from enum import Enum

from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import DRIVE_SIZE, MAXIMUM_SENSED_VALUES, Acceleration, Set, SetFlag, TimeRequest

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
MS_PER_S = 1_000
# A start bit, eight of data, a stop bit.
UART_BITS_PER_BYTE = 10
EXCHANGE_PERIOD_NS = 980 * NS_PER_MS  # 200 ppm of it widen the bounds of the clock by 0.2 ms (PROTOCOL.md)
# A sequence says its age up to here: with more frames within a lease, old ones could not be told from new ones.
LONGEST_SEQUENCE_LEAD = 127


class Transport(Enum):
    """Kinds of transport; all but a UART ignore the bit rate that a port is opened with."""

    UART = "UART"
    USB_FULL_SPEED = "USB full speed"
    USB_HIGH_SPEED = "USB high speed"
    BLUETOOTH = "Bluetooth serial"


# The rest is for STATUS and answers, and for an accelerometer that is faster than it says.
SENSED_SHARE = 0.8


# Bytes of a packet, and the time that each takes, however full it is.
_PACKETS = {
    # One bulk packet a frame: a busy bus gives no more.
    Transport.USB_FULL_SPEED: (64, NS_PER_MS),
    Transport.USB_HIGH_SPEED: (512, NS_PER_MS // 8),
    # A DH5 packet takes five slots of 625 us and its answer one; of its 339 bytes RFCOMM and L2CAP leave 330.
    Transport.BLUETOOTH: (330, 6 * 625_000),
}


def occupied_ns(transport: Transport, bit_rate_hz: int, size: int) -> int:
    """Duration for which `size` bytes written at once occupy the line."""
    if transport is Transport.UART:
        return size * UART_BITS_PER_BYTE * NS_PER_S // bit_rate_hz
    packet_size, period_ns = _PACKETS[transport]
    return -(-size // packet_size) * period_ns


def command_rate_hz(transport: Transport, bit_rate_hz: int, number_of_actuators: int, lease_ms: int) -> float:
    """SETs a second that the line carries beside the time exchanges, one write each.

    Keepalives and renewals take nothing from it: they are sent where no command is.
    """
    set_size = len(encode_message(Set(0, SetFlag.WRITE_PHASE, 0, bytes(DRIVE_SIZE * number_of_actuators)), 0))
    exchange_ns = occupied_ns(transport, bit_rate_hz, len(encode_message(TimeRequest(0), 0)))
    free = 1.0 - exchange_ns / EXCHANGE_PERIOD_NS
    by_line_hz = free * NS_PER_S / occupied_ns(transport, bit_rate_hz, set_size)
    return min(by_line_hz, LONGEST_SEQUENCE_LEAD * MS_PER_S / lease_ms)


def sensed_rate_hz(transport: Transport, bit_rate_hz: int, number_of_actuators: int) -> float:
    """Samples a second of an accelerometer that the line carries in ACCELERATION, in SENSED_SHARE of its time."""
    samples = MAXIMUM_SENSED_VALUES // (1 + number_of_actuators)
    values = (0,) * samples * (1 + number_of_actuators)
    size = len(encode_message(Acceleration(0, 0, 0, len(values), values), 0))
    return SENSED_SHARE * samples * NS_PER_S / occupied_ns(transport, bit_rate_hz, size)
