"""Laws of the lines: what they carry is what their bits allow, and more is refused with the number."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import firmware_link
from firmware_link.host.link_values import LinkConfiguration
from firmware_link.protocol.errors import LinkError
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.line_rate import NS_PER_S, Transport, command_rate_hz, occupied_ns, sensed_rate_hz
from firmware_link.protocol.messages import DRIVE_SIZE, Set, SetFlag
from tests.firmware_link.strategies import unhurried

PROTOCOL = (Path(firmware_link.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("transport", "bit_rate_hz", "rate_hz"),
    [
        (Transport.UART, 115_200, 479),
        (Transport.UART, 921_600, 3175),
        (Transport.USB_FULL_SPEED, 0, 998),
        (Transport.USB_HIGH_SPEED, 0, 3175),
        (Transport.BLUETOOTH, 0, 265),
    ],
)
def test_the_rate_for_two_actuators_is_known(transport: Transport, bit_rate_hz: int, rate_hz: int) -> None:
    assert int(command_rate_hz(transport, bit_rate_hz, 2, 40)) == rate_hz
    assert f" {rate_hz}" in PROTOCOL


@unhurried
@given(st.integers(1200, 4_000_000), st.integers(1, 255), st.integers(1, 100))
def test_commands_at_that_rate_fit_a_uart(bit_rate_hz: int, number_of_actuators: int, lease_ms: int) -> None:
    rate_hz = command_rate_hz(Transport.UART, bit_rate_hz, number_of_actuators, lease_ms)
    frame = encode_message(Set(0, SetFlag.WRITE_PHASE, 40, bytes(DRIVE_SIZE * number_of_actuators)), 0)
    rounded = 1 + 1e-12  # a quotient times its divisor
    assert rate_hz * len(frame) * 10 <= bit_rate_hz * rounded
    assert rate_hz * lease_ms <= 127_000 * rounded


@unhurried
@given(st.integers(1, 5000))
def test_a_packet_takes_its_time_however_full(size: int) -> None:
    for transport, packet, seconds in ((Transport.USB_FULL_SPEED, 64, 1e-3), (Transport.BLUETOOTH, 330, 3.75e-3)):
        assert occupied_ns(transport, 115_200, size) == -(-size // packet) * round(seconds * NS_PER_S)


@pytest.mark.parametrize(
    ("transport", "reason"),
    [
        (Transport.UART, "1000 commands a second for 2 actuators are too many for UART at 115200 bit/s .* at most 479"),
        (Transport.BLUETOOTH, "too many for Bluetooth serial with a lease of 40 ms: ask for at most 265"),
    ],
)
def test_a_rate_that_the_line_cannot_carry_is_refused_with_the_one_that_it_can(
    transport: Transport, reason: str
) -> None:
    with pytest.raises(LinkError, match=reason):
        LinkConfiguration(2, transport=transport, command_rate_hz=1000)
    LinkConfiguration(2, transport=Transport.UART, bit_rate_hz=460_800, command_rate_hz=1000)


def test_the_samples_of_an_accelerometer_that_a_line_carries_are_those_of_the_document() -> None:
    section = PROTOCOL.partition("## Accelerometer")[2]
    lines = [(Transport.UART, rate) for rate in (115_200, 460_800, 921_600, 1_000_000)]
    for transport, bit_rate_hz in [*lines, (Transport.USB_FULL_SPEED, 0), (Transport.BLUETOOTH, 0)]:
        carried = (round(sensed_rate_hz(transport, bit_rate_hz, count)) for count in (1, 2, 4, 8))
        cells = " | ".join(f"{rate:,}".replace(",", " ") for rate in carried)
        assert f"| {cells} |" in section
