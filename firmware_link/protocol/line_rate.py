"""Capacity of a line: how long a write occupies it, and the samples of an accelerometer that it carries."""

from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import MAXIMUM_SENSED_VALUES, Acceleration

NS_PER_S = 1_000_000_000
UART_BITS_PER_BYTE = 10  # a start bit, eight of data, a stop bit
SENSED_SHARE = 0.8  # the rest is for STATUS and answers, and for an accelerometer that is faster than it says


def occupied_ns(bit_rate_hz: int, size: int) -> int:
    """Duration for which `size` bytes occupy a serial line; USB, which ignores the bit rate, is taken for one."""
    return size * UART_BITS_PER_BYTE * NS_PER_S // bit_rate_hz


def sensed_rate_hz(bit_rate_hz: int, number_of_actuators: int) -> float:
    """Samples a second of an accelerometer that the line carries in ACCELERATION, in SENSED_SHARE of its time."""
    samples = MAXIMUM_SENSED_VALUES // (1 + number_of_actuators)
    values = (0,) * samples * (1 + number_of_actuators)
    size = len(encode_message(Acceleration(0, 0, 0, len(values), values), 0))
    return SENSED_SHARE * samples * NS_PER_S / occupied_ns(bit_rate_hz, size)
