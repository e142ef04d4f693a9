"""The law of a sound card as a board: never above its limit, silent without its host, on the clock of its samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from base.arrays import Array
from firmware_link.protocol.drive_words import ChannelDrive
from tactable.audio.board import CardPace
from tactable.audio.simulated_card import CardFlaws, SimulatedCard
from tests.firmware_link.law_host import RAMP_US, Host
from tests.firmware_link.strategies import channel_drives, messages
from tests.tactable.audio.cards import OUTPUT, core

LEASE_US = 40_000
LEAST = 1e-9
BLOCK_US = OUTPUT.block * 1e6 / OUTPUT.rate_hz
LOUD = (ChannelDrive(150.0, 1.0), ChannelDrive(209.0, 1.0))


class CardTier:
    """A simulated card as the conformance suite reaches a device, in virtual time."""

    lease_ms = 40
    slack_us = 10_000

    def __init__(self, flaws: CardFlaws | None = None) -> None:
        self.card = SimulatedCard(core(), OUTPUT, flaws)
        self._now_us, self._said = 0, b""

    def now_us(self) -> int:
        return self._now_us

    def write(self, data: bytes) -> None:
        self._said += self.card.receive(data, self._now_us)

    def wait(self, duration_us: int) -> None:
        self._now_us += duration_us
        self._said += self.card.run_until(self._now_us)

    def read(self) -> bytes:
        said, self._said = self._said, b""
        return said

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        return tuple(abs(self.played(start_us, stop_us)).max(axis=0, initial=0.0))

    def reboot(self) -> None:
        pytest.fail("a sound card cannot be started again from its host")

    def played(self, start_us: float, stop_us: float) -> Array:
        return self.card.drive(start_us, stop_us, OUTPUT.rate_hz)


def driving() -> tuple[CardTier, Host]:
    """A card that plays both actuators at full scale for as long as it is renewed."""
    tier = CardTier()
    host = Host(tier).ready()
    for _ in range(10):
        host.send(host.set_message(host.drive(*LOUD)))
        tier.wait(10_000)
    return tier, host


@settings(max_examples=10, deadline=None)
@given(
    drives=st.lists(st.tuples(channel_drives, channel_drives), max_size=4),
    others=st.lists(messages(2), max_size=6),
    garbage=st.binary(max_size=40),
    lost=st.lists(st.integers(0, 5_000), max_size=3),
)
def test_no_sample_is_above_the_limit_whatever_is_asked(
    drives: list[tuple[ChannelDrive, ChannelDrive]], others: list[object], garbage: bytes, lost: list[int]
) -> None:
    tier, host = driving()
    greatest = np.float32(OUTPUT.most)
    for drive in drives:
        host.send(host.set_message(host.drive(*drive)))
        tier.wait(15_000)
    tier.write(garbage + b"\0")
    for message in others:
        host.send(message)  # type: ignore[arg-type]  # any message
        tier.wait(4_000)
    for count in lost:
        samples, _ = tier.card.board.render(garbage, OUTPUT.block, count)
        assert abs(samples).max() <= greatest
    played = tier.played(0, tier.now_us())
    assert abs(played).max() <= greatest
    assert abs(played).max() > 0.5 * OUTPUT.most


def test_a_host_that_stands_still_is_faded_out_within_a_lease_a_ramp_and_a_block() -> None:
    tier, _ = driving()
    stalled_us = tier.now_us() - 10_000
    tier.wait(500_000)
    played = tier.played(0, tier.now_us())
    assert abs(played).max() == pytest.approx(OUTPUT.most, rel=0.01)
    last_us = (np.flatnonzero(abs(played).max(axis=1) > LEAST)[-1] + 1) * 1e6 / OUTPUT.rate_hz
    late_us = 1e6 * CardFlaws().latency_s + BLOCK_US
    assert LEASE_US < last_us - stalled_us <= LEASE_US + RAMP_US + late_us + 2e6 / OUTPUT.rate_hz
    # It ramps: no step greater than the slew and the tones themselves make.
    assert abs(np.diff(played, axis=0)).max() < 0.06


def test_a_card_that_ran_dry_rises_from_silence_and_keeps_its_clock() -> None:
    tier, host = driving()
    tier.card.stall(25_000)
    stalled_us = tier.now_us()
    for _ in range(20):
        host.send(host.set_message(host.drive(*LOUD)))
        tier.wait(5_000)
    assert tier.card.gaps == 1
    assert tier.card.board.time_us == pytest.approx(tier.now_us(), abs=2 * BLOCK_US)
    after = tier.played(stalled_us, tier.now_us())
    gap = np.flatnonzero(abs(after).max(axis=1) == 0)
    assert len(gap) / OUTPUT.rate_hz == pytest.approx(0.025, abs=0.006)
    rise = abs(after[gap[-1] : gap[-1] + 48]).max()
    assert rise < 0.25 * OUTPUT.most


def test_a_host_that_is_gone_silences_at_once() -> None:
    tier, _ = driving()
    tier.card.board.hang_up()
    gone_us = tier.now_us()
    tier.wait(100_000)
    silent = tier.played(gone_us + RAMP_US + 1e6 * CardFlaws().latency_s + BLOCK_US, tier.now_us())
    assert abs(silent).max() < LEAST


@pytest.mark.parametrize("drift", [0.0, 150e-6])
def test_the_clock_of_the_host_is_compared_with_that_of_the_card(drift: float) -> None:
    tier = CardTier(CardFlaws(drift=drift, jitter_s=0.004))
    host = Host(tier).ready()
    tier.wait(2_000_000)
    assert tier.card.gaps == 0
    host.compare_clocks()
    assert host.device_us() == pytest.approx(tier.card.board.time_us, abs=2 * BLOCK_US)
    assert tier.card.board.time_us - tier.now_us() == pytest.approx(drift * tier.now_us(), abs=2 * BLOCK_US)


def test_the_pace_counts_what_a_card_played_by_itself() -> None:
    pace = CardPace(48_000)
    for block in range(400):
        assert pace.lost(block * 5_000_000, 240, ran_dry=False) == 0
    assert pace.lost(400 * 5_000_000 + 20_000_000, 240, ran_dry=True) == pytest.approx(960, abs=20)
    assert pace.lost(401 * 5_000_000 + 20_000_000, 240, ran_dry=False) == 0
