"""The emulated part: counts as its data sheet says, at its own pace, and texts that are refused."""

import numpy as np
import pytest

from firmware_link.emulator.device_state import DeviceConfiguration
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
    NOISE_M_PER_S2,
    RATE_HZ,
    SCALE_M_PER_S2,
    AccelerometerError,
    EmulatedAccelerometer,
    SensedSurface,
)
from tests.engine.loop.rig import DEVICE
from tests.tactable.page.test_plate_page import plate

SECONDS = 2


def test_a_point_on_the_surface_is_taken_and_one_beside_it_refused() -> None:
    for device, here, beside in (
        (DEVICE, "at=50mm", ("at=50 x 20 mm", "at=900mm")),
        (plate(), "at=0 x 120 mm", ("at=50mm", "at=50 x 121 mm")),
    ):
        SensedSurface(device, EmulatedAccelerometer.parse(here), 1)
        for text in beside:
            with pytest.raises(AccelerometerError, match=f"off the {device.surface.kind}"):
                SensedSurface(device, EmulatedAccelerometer.parse(text), 1)


def test_a_bar_at_rest_reads_gravity_with_the_noise_the_resolution_and_the_pace_of_the_part() -> None:
    """What a board that nobody drives streams in SECONDS; what clips at the end of the range is a law of measuring."""
    board = SensedSurface(DEVICE, EmulatedAccelerometer.parse("at=50mm, drift=20000"), 1).boot(DeviceConfiguration(1))
    said = board.receive(encode_message(HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 1), 1), 1_000)
    said += board.receive(encode_message(Sense(1_000 * SECONDS), 2), 2_000)
    for now_us in range(7_000, 1_000_000 * SECONDS + 100_000, 5_000):
        said += board.run_until(now_us)
    messages = [decode_body(item)[1] for item in FrameDecoder().receive(said) if isinstance(item, bytes)]
    frames = [message for message in messages if isinstance(message, Acceleration)]
    counts = np.concatenate([np.array(frame.values).reshape(-1, 3)[:, 0] for frame in frames])
    first, last = frames[0], frames[-1]
    rate_hz = 48_000 * (last.number - first.number) / (last.synthesis_sample - first.synthesis_sample)
    assert rate_hz == pytest.approx(1.02 * RATE_HZ, rel=1e-5)
    assert len(counts) == pytest.approx(SECONDS * rate_hz, rel=0.02)
    assert not (counts % 2).any()
    assert counts.mean() == pytest.approx(256, abs=1)
    assert counts.std() * SCALE_M_PER_S2 == pytest.approx(NOISE_M_PER_S2, rel=0.05)
