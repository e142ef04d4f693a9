"""The light device: it sees every command, and a session goes on although the firmware is shown few SETs."""

from hypothesis import given
from hypothesis import strategies as st

from engine.render.limits import link_configuration
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkState
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import Play, Set, SetFlag, TimeRequest
from tactable.bench.light_device import LightDevice
from tactable.shipped import find_device

MS = 1_000_000
drives = st.binary(min_size=12, max_size=12)
weights = st.lists(st.integers(-(2**15), 2**15 - 1), max_size=60).map(tuple)


def message_of(clock: int, content: bytes | tuple[int, ...]) -> Set | Play:
    """A SET of a drive, or a PLAY of weights."""
    if isinstance(content, bytes):
        return Set(clock, SetFlag.WRITE_PHASE, 40, content)
    return Play(clock, 0, 1, 0, len(content), content)


@given(
    st.lists(st.tuples(st.integers(0, 255), st.integers(0, 65_535), drives | weights), max_size=20), st.integers(1, 40)
)
def test_every_command_is_noted_with_its_sequence_however_the_bytes_come(
    commands: list[tuple[int, int, bytes | tuple[int, ...]]], piece: int
) -> None:
    device = LightDevice(DeviceConfiguration(0), 0)
    frames = [encode_message(message_of(clock, content), number) for number, clock, content in commands]
    stream = b"".join(frame + encode_message(TimeRequest(5), 6) for frame in frames)
    for start in range(0, len(stream), piece):
        device.receive(stream[start : start + piece], start)
    assert list(device.arrivals.sequence) == [number for number, _, _ in commands]
    assert list(device.arrivals.time_ns) == sorted(device.arrivals.time_ns)


def test_a_session_goes_on_at_any_rate() -> None:
    link, device, now_ns = (
        Link(link_configuration(find_device("reference-a"), 10**9)),
        LightDevice(DeviceConfiguration(0), 0),
        10**9,
    )
    link.connect(now_ns)
    sent = 0
    while now_ns < 3 * 10**9:
        now_ns += MS // 2
        if link.state is LinkState.READY:
            link.set_drive(bytes([1 + sent % 200] * 12))
            sent += 1
        link.receive(device.receive(link.outgoing(now_ns), now_ns) + device.run_until(now_ns), now_ns)
        link.poll(now_ns)
    assert link.state is LinkState.READY
    assert link.status is not None
    assert (link.status.stale, link.status.trips) == (0, 0)
    assert len(device.arrivals.time_ns) == link.counters.sent + link.counters.renewed > 3000
