"""The emulated part: counts as its data sheet says, at its own pace, and texts that are refused."""

import numpy as np
import pytest

from firmware_link.emulator import DeviceConfiguration
from firmware_link.protocol.framing import FrameDecoder, encode_message
from firmware_link.protocol.messages import (
    MAGIC,
    VERSION_MAJOR,
    VERSION_MINOR,
    Acceleration,
    HelloRequest,
    Sense,
    decode_body,
)
from tactable.rig.accelerometer import (
    GREATEST,
    NOISE_M_PER_S2,
    RATE_HZ,
    SCALE_M_PER_S2,
    EmulatedAccelerometer,
    SensedBar,
)
from tests.engine.loop.rig import DEVICE

SECONDS = 2


def frames_of(text: str, bar: SensedBar | None = None) -> list[Acceleration]:
    """What a board that nobody drives streams in SECONDS."""
    board = (bar or SensedBar(DEVICE, EmulatedAccelerometer.parse(text), 1)).boot(DeviceConfiguration(1))
    said = board.receive(encode_message(HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 1), 1), 1_000)
    said += board.receive(encode_message(Sense(1_000 * SECONDS), 2), 2_000)
    for now_us in range(7_000, 1_000_000 * SECONDS + 100_000, 5_000):
        said += board.run_until(now_us)
    items = FrameDecoder().receive(said)
    messages = [decode_body(item)[1] for item in items if isinstance(item, bytes)]
    return [message for message in messages if isinstance(message, Acceleration)]


def counts_of(frames: list[Acceleration]) -> np.ndarray:
    return np.concatenate([np.array(frame.values).reshape(-1, 3)[:, 0] for frame in frames])


def test_a_bar_at_rest_reads_gravity_with_the_noise_and_the_resolution_of_the_part() -> None:
    counts = counts_of(frames_of("at=50mm"))
    assert len(counts) == pytest.approx(SECONDS * RATE_HZ, rel=0.02)
    assert not (counts % 2).any()
    assert counts.mean() == pytest.approx(256, abs=1)
    assert counts.std() * SCALE_M_PER_S2 == pytest.approx(NOISE_M_PER_S2, rel=0.05)


def test_its_oscillator_is_its_own_and_it_clips_at_the_end_of_its_range() -> None:
    frames = frames_of("at=50mm, offset=200m/s^2, drift=20000")
    first, last = frames[0], frames[-1]
    rate_hz = 48_000 * (last.number - first.number) / (last.synthesis_sample - first.synthesis_sample)
    assert rate_hz == pytest.approx(1.02 * RATE_HZ, rel=1e-5)
    assert set(counts_of(frames).tolist()) == {GREATEST}
