"""How long a dead host can be felt: the bound that docs/safety.md derives, kept by both cores in virtual time.

What a host made before it died may still lie on a line that stalls. A frame is fresh while its clock reference is at
most one armed lease old, so the last one is applied at most a lease after it was made; its drive lives for another
lease, and then falls at the slew.
"""

import random
from collections.abc import Callable

import numpy as np
import pytest

from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import CLOCK_REFERENCE_US, KeepAlive
from tests.firmware_link.firmware.compiled_core import CompiledTier
from tests.firmware_link.law_host import CLICKS, DISARM_US, LOUD, RAMP_US, WAVEFORM_US, Host, WaveTier, with_basis
from tests.firmware_link.test_conformance import VirtualTier

TIERS = (VirtualTier, CompiledTier)
LEASE_US = 1_000 * VirtualTier.lease_ms
SAMPLE_US = 50
BOUND_US = 2 * LEASE_US + RAMP_US + CLOCK_REFERENCE_US + SAMPLE_US


def silence_after_us(tier: WaveTier, host: Host, last: Message, delay_us: int) -> float:
    """Time from now, when the host's last frame was made, which comes `delay_us` later, until all stays still."""
    made_us, frame = host.device_us(), host.frame(last)
    tier.wait(delay_us)
    tier.write(frame)
    tier.wait(DISARM_US + 2 * LEASE_US)
    rate_hz, moves = tier.outputs(made_us, host.device_us())
    moving = np.flatnonzero(np.abs(moves).max(axis=1, initial=0.0) > 0)
    return (moving[-1] + 1) * 1e6 / rate_hz if moving.size else 0.0


@pytest.mark.parametrize("tier_of", TIERS)
def test_a_drive_of_a_dead_host_ends_within_two_leases_and_a_ramp(tier_of: Callable[[], WaveTier]) -> None:
    rng, greatest_us = random.Random(1), 0.0
    for delay_us in (0, LEASE_US, LEASE_US + 2 * CLOCK_REFERENCE_US, *(rng.randrange(2 * LEASE_US) for _ in range(20))):
        tier = tier_of()
        host = Host(tier).ready()
        sequence = host.set(host.drive(*LOUD)).applied_sequence
        tier.wait(rng.randrange(LEASE_US // 3))
        lasts = (host.set_message(host.drive(*LOUD)), KeepAlive(host.clock_reference(), sequence))
        after_us = silence_after_us(tier, host, rng.choice(lasts) if delay_us != LEASE_US else lasts[0], delay_us)
        assert after_us <= BOUND_US, f"last frame {delay_us} us under way"
        greatest_us = max(greatest_us, after_us)
    # The bound is no larger than it must be.
    assert greatest_us > BOUND_US - 1_000


@pytest.mark.parametrize("tier_of", TIERS)
def test_a_click_of_a_dead_host_ends_within_a_lease_and_its_length(tier_of: Callable[[], WaveTier]) -> None:
    for delay_us in (0, LEASE_US // 2, LEASE_US, LEASE_US + 2 * CLOCK_REFERENCE_US):
        tier = tier_of()
        host = with_basis(tier)
        after_us = silence_after_us(tier, host, CLICKS.play(0, host.clock_reference()), delay_us)
        assert after_us <= LEASE_US + WAVEFORM_US + CLOCK_REFERENCE_US + SAMPLE_US
