"""Laws of the stream of an accelerometer on the host: asked of a device that has one, held, and ended."""

from dataclasses import dataclass, field
from typing import Any

import pytest

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.host.link_values import AccelerometerDescribed, LinkConfiguration
from firmware_link.host.sensing import LEASE_MS
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import ACCELEROMETER, Acceleration, Sense
from tests.firmware_link.virtual_rig import BOOT_ID, STEP_NS, VirtualRig, decode_messages
from tests.tools.virtual import MS

RATE_HZ = 2_000
SENSING = DeviceConfiguration(
    BOOT_ID, sensor_rate_mhz=1_000 * RATE_HZ, sensor_scale_nm_per_s2=38_303_000, sensor_greatest=4_095
)


@dataclass
class SensingRig(VirtualRig):
    """A rig whose device takes a sample every two steps."""

    device_configuration: DeviceConfiguration = field(default_factory=lambda: SENSING)

    def step(self) -> None:
        super().step()
        if self.now_ns % (2 * STEP_NS) < STEP_NS:
            self.firmware.sense(self.line.device_us() % 4_000, [1, 2], self.line.device_us() * 48 // 1_000)

    def sensed(self) -> list[Acceleration]:
        return [event for event in self.events if isinstance(event, Acceleration)]

    def samples(self) -> int:
        return sum(event.number_of_values // 3 for event in self.sensed())


def asked_of(rig: VirtualRig) -> list[Sense]:
    """What the host asked of the accelerometer."""
    messages = decode_messages(b"".join(data for _, data in rig.line.written))
    return [message for message in messages if isinstance(message, Sense)]


def sensing(**settings: Any) -> SensingRig:
    """Connected, with its stream on."""
    rig = SensingRig(**settings)
    rig.connect()
    rig.link.start_sensing(rig.now_ns)
    return rig


def test_a_board_without_an_accelerometer_is_refused_and_never_asked() -> None:
    rig = VirtualRig()
    rig.connect()
    with pytest.raises(LinkError, match="no accelerometer"):
        rig.link.start_sensing(rig.now_ns)
    rig.run(300 * MS)
    assert not asked_of(rig)
    assert rig.link.capabilities is not None
    assert ACCELEROMETER not in rig.link.capabilities.features


def test_nothing_is_asked_before_the_device_is_armed_or_without_a_wish() -> None:
    rig = SensingRig()
    with pytest.raises(LinkError, match="armed"):
        rig.link.start_sensing(0)
    rig.connect()
    rig.run(300 * MS)
    assert not asked_of(rig) and not rig.sensed()
    assert rig.link.counters.unexpected == 0


def test_a_stream_is_renewed_as_long_as_it_is_wanted_and_ends_by_itself() -> None:
    rig = sensing()
    rig.run(2_000 * MS)
    described = next(event for event in rig.events if isinstance(event, AccelerometerDescribed))
    assert (described.rate_hz, described.greatest, described.lost) == (RATE_HZ, 4_095, 0)
    assert described.scale_m_per_s2 == pytest.approx(38.303e-3)
    assert rig.samples() == pytest.approx(2 * RATE_HZ, rel=0.02)
    # Asked for its form first, then for leases.
    assert [sense.lease_ms for sense in asked_of(rig)][:3] == [0, LEASE_MS, LEASE_MS]
    rig.is_host_alive = False
    rig.run((LEASE_MS + 50) * MS)
    assert not rig.firmware.senses


def test_a_stream_outlives_lost_frames_of_the_host_and_ends_with_its_session() -> None:
    rig = sensing(drop_every=3)
    rig.run(2_000 * MS)
    before = rig.samples()
    rig.run(1_000 * MS)
    assert rig.samples() - before == pytest.approx(RATE_HZ, rel=0.02)
    rig.link.stop(rig.now_ns)
    asked = len(asked_of(rig))
    rig.run((LEASE_MS + 100) * MS)
    assert len(asked_of(rig)) == asked
    assert not rig.firmware.senses


def test_a_line_that_is_too_slow_is_refused_by_name_before_the_stream_begins() -> None:
    rig = sensing(link_configuration=LinkConfiguration(2, bit_rate_hz=115_200))
    with pytest.raises(LinkError, match=r"2000 samples a second and a line of 115200 bit/s carries 1398.*--bit-rate"):
        rig.run(200 * MS)
    assert not rig.firmware.senses
    assert not rig.sensed()
