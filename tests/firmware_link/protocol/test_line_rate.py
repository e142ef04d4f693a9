"""Laws of the line, which carries what its bits allow as the document says, and of the clicks that take over on it."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import firmware_link
from firmware_link.host.link import EXCHANGE_PERIOD_NS
from firmware_link.host.outbox import LONGEST_SEQUENCE_LEAD, Lease
from firmware_link.protocol.drive_words import DRIVE_SIZE
from firmware_link.protocol.framing import NS_PER_S, encode_message, occupied_ns, sensed_rate_hz
from firmware_link.protocol.messages import FULL_SCALE_WORD, Play, Set, SetFlag, TimeRequest
from firmware_link.protocol.player import WAVEFORMS_AT_ONCE, Player
from tests.firmware_link.strategies import unhurried

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


def test_a_waveform_that_is_taken_over_sounds_for_its_fade_rounded_up_and_a_margin_or_until_its_end() -> None:
    player = Player()
    player.start(0, 100_000, FULL_SCALE_WORD)
    player.take_over(10_000, 200)
    player.start(10_000, 12_000, FULL_SCALE_WORD)
    assert player.room_us(10_000) == 15_000
    player.take_over(21_000, 200)
    assert player.room_us(21_000) == 21_000
    player.start(21_000, 50_000, 1)
    assert player.room_us(21_000) == 22_000
    player.take_over(22_000, 1, margin_us=7)
    player.start(22_000, 50_000, 1)
    assert player.room_us(22_000) == 22_016 + 7


@unhurried
@given(st.lists(st.tuples(st.integers(0, 8_000), st.booleans(), st.integers(0, FULL_SCALE_WORD)), max_size=30))
def test_never_do_more_than_two_sound(moves: list[tuple[int, bool, int]]) -> None:
    player, now_us, sounding = Player(), 0, list[list[int]]()
    for pause_us, plays, amplitude in moves:
        now_us += pause_us
        if player.end_us is not None and player.end_us <= now_us:
            player.finish()
        if plays and not player.has_room(now_us):
            assert player.room_us(now_us) > now_us
            continue
        if player.end_us is not None:
            sounding[-1][0] = min(sounding[-1][0], now_us + -(-sounding[-1][1] * 5_000 // FULL_SCALE_WORD))
        player.take_over(now_us, 200)
        if plays:
            player.start(now_us, 20_000, amplitude)
            sounding.append([now_us + 20_000, amplitude])
        assert sum(end_us > now_us for end_us, _ in sounding) <= WAVEFORMS_AT_ONCE
