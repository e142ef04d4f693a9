"""The light device: it sees every command, and a session goes on although the firmware is shown few SETs."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import Play, Set, SetFlag, TimeRequest
from tactable.bench.light_device import LightDevice

drives = st.binary(min_size=12, max_size=12)
weights = st.lists(st.integers(-(2**15), 2**15 - 1), max_size=60).map(tuple)


def message_of(clock: int, content: bytes | tuple[int, ...]) -> Set | Play:
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
