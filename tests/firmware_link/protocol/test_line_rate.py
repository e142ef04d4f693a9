"""Laws of the line: what it carries is what its bits allow, and the document says so."""

from pathlib import Path

import pytest

import firmware_link
from firmware_link.host.link import EXCHANGE_PERIOD_NS
from firmware_link.host.outbox import LONGEST_SEQUENCE_LEAD, Lease
from firmware_link.protocol.drive_words import DRIVE_SIZE
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.line_rate import NS_PER_S, occupied_ns, sensed_rate_hz
from firmware_link.protocol.messages import Play, Set, SetFlag, TimeRequest

PROTOCOL = (Path(firmware_link.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("bit_rate_hz", "rate_hz"), [(115_200, 479), (921_600, 3175)])
def test_the_commands_that_a_line_carries_are_those_of_the_document(bit_rate_hz: int, rate_hz: int) -> None:
    command = encode_message(Set(0, SetFlag.WRITE_PHASE, 0, bytes(2 * DRIVE_SIZE)), 0)
    exchange = encode_message(TimeRequest(0), 0)
    free = 1 - occupied_ns(bit_rate_hz, len(exchange)) / EXCHANGE_PERIOD_NS
    by_line_hz = free * NS_PER_S / occupied_ns(bit_rate_hz, len(command))
    by_lease_hz = LONGEST_SEQUENCE_LEAD * NS_PER_S / (40 * 10**6)
    assert int(min(by_line_hz, by_lease_hz)) == rate_hz
    assert f" {rate_hz}" in PROTOCOL
    assert Lease(40).spacing_ns == -(-NS_PER_S // int(by_lease_hz))


def test_the_samples_of_an_accelerometer_that_a_line_carries_are_those_of_the_document() -> None:
    section = PROTOCOL.partition("## Accelerometer")[2]
    for bit_rate_hz in (115_200, 460_800, 921_600, 1_000_000):
        carried = (round(sensed_rate_hz(bit_rate_hz, count)) for count in (1, 2, 4, 8))
        cells = " | ".join(f"{rate:,}".replace(",", " ") for rate in carried)
        assert f"| {cells} |" in section


@pytest.mark.parametrize("actuators", [2, 3, 4, 8])
def test_what_a_click_costs_on_each_line_is_what_the_document_says(actuators: int) -> None:
    weights = 22 * actuators
    size = len(encode_message(Play(0, 0, 1, 0, weights, (0,) * weights), 0))
    costs_ms = [occupied_ns(rate_hz, size) / 1e6 for rate_hz in (57_600, 115_200, 230_400, 921_600, 2_000_000)]
    cells = " | ".join(f"{cost_ms:.1f} ms" if cost_ms <= 20 else "-" for cost_ms in costs_ms)
    assert (
        f"\n| {actuators} | {weights} | {size} bytes | {cells} | {size * 500:,} bit/s |".replace(",", " ") in PROTOCOL
    )
