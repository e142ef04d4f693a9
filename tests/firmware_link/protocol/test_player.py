"""Laws of the takeovers: how long what was taken over still sounds, and never more than two at once."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol.messages import FULL_SCALE_WORD
from firmware_link.protocol.player import WAVEFORMS_AT_ONCE, Player
from tests.firmware_link.strategies import unhurried


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
