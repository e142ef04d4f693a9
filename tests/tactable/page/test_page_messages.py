"""What the page's server and a browser tell each other: round trips, and what is refused by which code."""

import json
import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.touch.sources.pointer import Phase, PointerEvent
from tactable.page.page_messages import (
    MOST_BYTES,
    MOST_CHOICE_BYTES,
    MOST_TOUCHES,
    VERSION,
    ChannelPicture,
    CloseCode,
    Drive,
    DroppedFile,
    FingerPicture,
    Kind,
    MadePicture,
    PageMessageError,
    PaperPicture,
    Picture,
    Role,
    decode_message,
    encode_motion,
    encode_picture,
    encode_scene,
)
from tests.tactable.page.browser import decode_picture, encode_choice, encode_device, encode_listen, encode_touches

FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)
EVENTS = st.builds(PointerEvent, st.integers(0, 2**32 - 1), FLOATS, FLOATS, st.sampled_from(Phase))
STAGES = (1, 2, 3, 4, 5)
PICTURE = Picture(
    time_s=1.5,
    counters=(1, 2, 3, 4, 5, 6),
    command=7,
    age_s=0.25,
    wanted_db=math.inf,
    last_ns=STAGES,
    median_ns=STAGES,
    latencies=9,
    drive=Drive.STEADY,
    is_loaded=True,
    is_playing=True,
    is_late=False,
    fingers=(
        FingerPicture(3, None, Role.NONE, 0.125, 20.5, 21.5),
        FingerPicture(4, 2, Role.QUIET, 0.25 + 0.5j, -60.0, -3.0),
    ),
    made=(
        MadePicture(4, 2, Role.QUIET, 0.25 + 0.5j, -4.5, None),
        MadePicture(None, None, Role.FELT, 0.5, 20.0, 19.5, 18.25, 21.0),
    ),
    channels=(ChannelPicture(183.25, 0.5, -1.0),),
    levels_db=np.array([-99.0, 0.123, 99.0]),
    counted_db=np.array([-20.0, 16.5, 61.0]),
    rows=3,
)


@given(
    st.lists(EVENTS, min_size=1, max_size=MOST_TOUCHES),
    st.dictionaries(
        st.text(max_size=20), st.none() | st.booleans() | st.floats(allow_nan=False) | st.text(max_size=20), max_size=8
    ),
    st.integers(0, 2**32 - 1),
    st.text(max_size=99),
    st.text(max_size=999),
)
def test_what_a_browser_says_comes_as_it_was(
    events: list[PointerEvent], switches: dict[str, object], finger: int, name: str, text: str
) -> None:
    assert decode_message(encode_touches(events)) == tuple(events)
    assert decode_message(encode_choice(switches)) == switches
    assert decode_message(encode_listen(finger)) == finger
    assert decode_message(encode_device(name, text)) == DroppedFile(name, text)


@given(st.binary(max_size=2 * MOST_BYTES), st.binary(max_size=64), st.sampled_from(Kind))
def test_any_bytes_are_a_message_or_refused(data: bytes, body: bytes, kind: Kind) -> None:
    for each, codes in ((data, [*CloseCode]), (bytes([VERSION, kind]) + body, [CloseCode.MALFORMED])):
        try:
            decode_message(each)
        except PageMessageError as error:
            assert error.code in codes


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"", CloseCode.MALFORMED),
        (bytes([VERSION]), CloseCode.MALFORMED),
        (bytes([VERSION + 1, Kind.LISTEN]) + bytes(4), CloseCode.OTHER_VERSION),
        (bytes([VERSION, Kind.SCENE]) + b"{}", CloseCode.MALFORMED),
        (bytes([VERSION, Kind.LISTEN]) + bytes(3), CloseCode.MALFORMED),
        (bytes([VERSION, Kind.TOUCHES]), CloseCode.MALFORMED),
        (bytes([VERSION, Kind.TOUCHES]) + bytes(13 * (MOST_TOUCHES + 1)), CloseCode.MALFORMED),
        (bytes([VERSION, Kind.TOUCHES]) + struct.pack("<IBff", 1, 4, 0.5, 0.5), CloseCode.MALFORMED),
        (bytes([VERSION, Kind.TOUCHES]) + struct.pack("<IBff", 1, 0, math.nan, 0.5), CloseCode.MALFORMED),
        (bytes([VERSION, Kind.CHOICE]) + b"[1]", CloseCode.MALFORMED),
        (bytes([VERSION, Kind.CHOICE]) + b"{", CloseCode.MALFORMED),
        (bytes([VERSION, Kind.CHOICE]) + b"\xff", CloseCode.MALFORMED),
        (bytes([VERSION, Kind.CHOICE]) + b"[" * 2000, CloseCode.MALFORMED),
        (bytes([VERSION, Kind.CHOICE]) + b" " * (MOST_CHOICE_BYTES + 1), CloseCode.TOO_BIG),
        (bytes([VERSION, Kind.DEVICE]) + b" " * MOST_BYTES, CloseCode.TOO_BIG),
        (bytes([VERSION, Kind.DEVICE]) + b'{"name": "x.toml"}', CloseCode.MALFORMED),
        (bytes([VERSION, Kind.DEVICE]) + b'{"name": "x.toml", "text": 1}', CloseCode.MALFORMED),
    ],
)
def test_what_is_no_message_is_refused_by_a_code(data: bytes, code: CloseCode) -> None:
    with pytest.raises(PageMessageError) as caught:
        decode_message(data)
    assert caught.value.code is code


def test_a_picture_is_its_values_and_its_levels_to_a_hundredth_of_a_decibel() -> None:
    told, levels_db = decode_picture(encode_picture(PICTURE))
    assert (told["counters"], told["last_ns"], told["drive"], told["is_late"]) == ([*range(1, 7)], [*STAGES], 1, False)
    assert told["wanted_db"] is None  # full scale
    on_bar, on_plate = told["fingers"]
    assert (on_bar["position_m"], on_bar["zone"]) == (0.125, None)
    assert (on_plate["position_m"], on_plate["role"]) == ([0.25, 0.5], Role.QUIET)
    assert [(made["number"], made["simulated_db"], made["high_db"]) for made in told["made"]] == [
        (4, None, None),
        (None, 19.5, 21.0),
    ]
    assert levels_db.tolist() == [[-60.0, 0.12, 60.0], [-20.0, 16.5, 60.0]]
    paper = PaperPicture(
        fingers_db=((1.5, 2.5), (-60.0, -3.0)),
        simulated_db=(None, -7.25),
        levels_db=np.array([1.0, 2.0, 99.0]),
        counted_db=np.array([4.0, 5.0, 6.0]),
    )
    beside, levels_db = decode_picture(encode_picture(replace(PICTURE, paper=paper)))
    second = {"fingers_db": [[1.5, 2.5], [-60.0, -3.0]], "simulated_db": [None, -7.25]}
    assert beside == told | {"paper": second}
    assert levels_db[2:].tolist() == [[1.0, 2.0, 60.0], [4.0, 5.0, 6.0]]


def test_a_motion_is_told_to_the_greatest_acceleration_of_all_bars() -> None:
    acceleration = np.array([[[0.0, 1.0], [-2.0, 0.5], [2.0, 0.0]], [[0.0, 4.0], [-1.0, 0.5], [2.5, 0.0]]])
    data = encode_motion(acceleration, (1, 1), 0.001, 5, is_click=True)
    along, rows, fingers, is_click, steps, command, step_s, scale = struct.unpack_from("<4BHIff", data, 2)
    assert (along, rows, fingers, is_click, steps, command) == (1, 1, 1, 1, 3, 5)
    assert step_s == pytest.approx(0.001)
    words = np.frombuffer(data[20:], "<i2").reshape(2, 3, 2)
    assert words * scale / 32767 == pytest.approx(acceleration, abs=2e-4)
    assert scale == 4.0
    assert not any(encode_motion(np.zeros((1, 2, 3)), (3, 1), 0.001, 1, is_click=False)[20:])  # at rest


def test_a_scene_is_json_that_browsers_read() -> None:
    assert json.loads(encode_scene({"device": "ä"})[2:]) == {"device": "ä"}
    with pytest.raises(ValueError, match="JSON"):
        encode_scene({"level_db": math.inf})
