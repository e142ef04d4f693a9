"""What every device with an accelerometer keeps to, beside the laws of `conformance`: its stream is asked for and ends.

A tier's accelerometer takes SAMPLE_RATE_HZ samples a second while its stream is on.
"""

import itertools
from collections.abc import Callable
from typing import Any

from firmware_link.protocol.messages import (
    ACCELEROMETER,
    LONGEST_SENSE_MS,
    Acceleration,
    Accelerometer,
    DeviceState,
    Sense,
)
from tests.firmware_link.law_host import Host, Tier

SAMPLE_RATE_HZ = 1_000
ACCELEROMETER_OF_LAWS: dict[str, Any] = {
    "sensor_rate_mhz": 1_000 * SAMPLE_RATE_HZ,
    "sensor_scale_nm_per_s2": 38_303_000,
    "sensor_greatest": 4_095,
}
_US_PER_S, _LISTEN_US = 1_000_000, 50_000


def _sensing(tier: Tier, lease_ms: int) -> Host:
    host = Host(tier)
    hello = host.greet()
    assert ACCELEROMETER in hello.features
    host.send(Sense(lease_ms))
    told = host.expect(Accelerometer)
    assert told.rate_mhz == 1_000 * SAMPLE_RATE_HZ
    assert told.scale_nm_per_s2 == ACCELEROMETER_OF_LAWS["sensor_scale_nm_per_s2"]
    return host


def _samples(host: Host, frame: Acceleration) -> int:
    assert host.hello is not None
    return frame.number_of_values // (1 + host.hello.number_of_actuators)


def _frames(host: Host, wait_us: int) -> list[Acceleration]:
    """What comes within a time, and what came with the last answer; a terminal holds no more than a few kilobytes."""
    for _ in range(0, wait_us, _LISTEN_US):
        host.tier.wait(_LISTEN_US)
        host.listen()
    found, host.unread = host.unread, []
    return [message for message in found if isinstance(message, Acceleration)]


def _slack(tier: Tier, samples: int) -> int:
    """How many samples more or less may come; beyond virtual time an accelerometer has a pace of its own."""
    return 2 + (tier.slack_us * SAMPLE_RATE_HZ // _US_PER_S + samples // 50 if tier.slack_us else 0)


def sensing_law_a_stream_ends_with_its_lease(tier: Tier) -> None:
    host = _sensing(tier, 200)
    samples = sum(_samples(host, frame) for frame in _frames(host, 400_000))
    assert abs(samples - 200) <= _slack(tier, 200), samples
    assert not _frames(host, 200_000)
    assert host.fresh_status().state is DeviceState.IDLE


def sensing_law_no_lease_is_longer_than_the_longest(tier: Tier) -> None:
    host = _sensing(tier, 65_535)
    samples = sum(_samples(host, frame) for frame in _frames(host, 1_000 * LONGEST_SENSE_MS + 300_000))
    assert abs(samples - LONGEST_SENSE_MS) <= _slack(tier, LONGEST_SENSE_MS), samples


def sensing_law_frames_and_samples_are_numbered_without_a_gap(tier: Tier) -> None:
    host = _sensing(tier, 500)
    frames = _frames(host, 400_000)
    assert len(frames) > 5
    for before, after in itertools.pairwise(frames):
        assert after.frame == (before.frame + 1) % 65_536
        assert after.number == before.number + _samples(host, before)
    assert host.hello is not None
    # Both clocks count the same time, each to a sample.
    sensed = (frames[-1].number - frames[0].number) / SAMPLE_RATE_HZ
    played = (frames[-1].synthesis_sample - frames[0].synthesis_sample) / host.hello.synthesis_rate_hz
    assert abs(sensed - played) < 2 / SAMPLE_RATE_HZ


def sensing_law_nothing_streams_unasked_and_a_new_session_and_a_lease_of_0_end_the_stream(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    assert not _frames(host, 300_000)
    host = _sensing(tier, 1_000)
    assert _frames(host, 200_000)
    host.send(Sense(0))
    host.expect(Accelerometer)
    assert not _frames(host, 200_000)
    host = _sensing(tier, 1_000)
    host.greet()
    host.listen()
    assert not _frames(host, 200_000)


SensingLaw = Callable[[Tier], None]
SENSING_LAWS: tuple[SensingLaw, ...] = tuple(
    function for name, function in list(globals().items()) if name.startswith("sensing_law_")
)
