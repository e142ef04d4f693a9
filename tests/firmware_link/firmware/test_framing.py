"""Laws of the C frames: the decoder accepts, refuses and counts as the Python one does, whatever comes."""

import ctypes
import itertools
import os
from pathlib import Path

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.c_core import open_library
from firmware_link.protocol.framing import DELIMITER, EMERGENCY_STOP, FrameDecoder, encode_frame, encode_message
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import MAXIMUM_WEIGHTS, Features, Hello, Play, encode_body
from tests.firmware_link.corrupt import DAMAGES, Chance, count_outcomes, draw_batch
from tests.firmware_link.firmware.compiled_core import core_library
from tests.firmware_link.firmware.compiled_decoder import CompiledDecoder
from tests.firmware_link.strategies import messages, sequences, unhurried

ACTUATORS = 2
BATCH = 1_250
BATCHES = int(os.environ.get("TACTABLE_FRAME_BATCHES", "1"))
"""Of frames with each kind of damage."""
pieces = st.one_of(
    messages(ACTUATORS).map(lambda message: encode_message(message, 1)),
    st.builds(encode_body, messages(ACTUATORS), sequences).map(encode_frame),
    st.binary(max_size=300),
    st.sampled_from([DELIMITER, EMERGENCY_STOP, EMERGENCY_STOP[1:]]),
)


# Runs of 254 bytes without a zero, and a byte more or less, are where the code of a run is full.
runs = st.lists(st.sampled_from([1, 100, 253, 254, 255, 508, 509]).map(lambda size: b"\5" * size), max_size=4)


@unhurried
@given(st.one_of(st.binary(max_size=700), runs.map(b"\0".join)))
def test_bytes_are_stuffed_as_cobs_does_and_come_back(data: bytes) -> None:
    encode, decode = core_library().cobs_encode, core_library().cobs_decode
    encode.restype, decode.restype = ctypes.c_size_t, ctypes.c_bool
    out, size = ctypes.create_string_buffer(len(data) + len(data) // 254 + 2), ctypes.c_size_t()
    size.value = encode(data, ctypes.c_size_t(len(data)), out)
    assert out.raw[: size.value] == cobs.encode(data)
    assert decode(out, ctypes.byref(size)) and out.raw[: size.value] == data


@unhurried
@given(st.lists(pieces, max_size=20), st.lists(st.integers(0, 2_000), max_size=10))
def test_both_decoders_do_the_same_in_any_chunking(parts: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(parts)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    python, compiled = FrameDecoder(ACTUATORS), CompiledDecoder(core_library(), ACTUATORS)
    for start, stop in itertools.pairwise(edges):
        assert compiled.receive(stream[start:stop]) == python.receive(stream[start:stop])
    assert compiled.counters == python.counters
    compiled.close()


@pytest.mark.parametrize("damage", DAMAGES)
def test_both_decoders_refuse_the_same_damaged_frames(damage: str) -> None:
    chance, refused = Chance(f"3 {damage}"), 0
    python, compiled = FrameDecoder(ACTUATORS), CompiledDecoder(core_library(), ACTUATORS)
    for _ in range(BATCHES):
        batch = draw_batch(BATCH, chance)
        stream = b"".join(DAMAGES[damage](frame, chance) + b"\0" + whole for frame, whole in batch)
        received = compiled.receive(stream)
        assert received == python.receive(stream)
        refused += count_outcomes(batch, received)["refused"]
    assert compiled.counters == python.counters
    compiled.close()
    # Doubling a byte or the like may leave the frame as it was.
    assert refused > 0.85 * BATCH * BATCHES


@pytest.mark.parametrize("number_of_actuators", [1, 36, 100, 255])
def test_the_longest_frame_fits_the_buffer(number_of_actuators: int) -> None:
    full_scales_pm = (9,) * number_of_actuators
    sizes = (1, 1, 1, 1, 1, 1, 1, 1, 0, number_of_actuators)
    hello = Hello(1, 0, 1, 1, 1, Features(0), 0, 1, 0, *sizes, full_scales_pm)
    plays = (Play(0, 0, 14, 65_535, count, (1,) * count) for count in (0, 1, MAXIMUM_WEIGHTS))
    bodies = [encode_body(message, 1) for message in (hello, *plays)]
    compiled = CompiledDecoder(core_library(), number_of_actuators)
    for decoder in (compiled, FrameDecoder(number_of_actuators)):
        assert decoder.receive(b"".join(map(encode_frame, bodies))) == bodies
    compiled.close()


def test_a_file_that_is_no_library_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"nothing\.so is no library"):
        open_library(tmp_path / "nothing.so")
