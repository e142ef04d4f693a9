"""Laws of control messages: what the schema refuses the reader refuses, and errors name key, value and expectation."""

import json
import random

import jsonschema
import pytest

from tactable.control.requests import MOST_BYTES, ControlError, Request, decode_line, read_request
from tactable.shipped import find_device, named_effects
from tests.tactable.control.messages import HELLO, MESSAGE, SCHEMA, VALID, edited

DEVICE, EFFECTS = find_device("reference-a"), named_effects()


def read(message: dict[str, object]) -> Request:
    return read_request({key: value for key, value in message.items() if key != "id"}, DEVICE, EFFECTS, 1)


@pytest.mark.parametrize("message", VALID, ids=lambda message: message["type"])
def test_a_valid_message_is_read_and_fits_the_schema(message: dict[str, object]) -> None:
    read(message)
    MESSAGE.validate(message)
    assert decode_line(json.dumps(message).encode())[0] == message.get("id")


def test_the_schema_has_every_message_and_each_of_its_keys_is_read() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    kinds = {key.removeprefix("message_"): part for key, part in SCHEMA["$defs"].items() if key.startswith("message_")}
    assert set(kinds) == {message["type"] for message in VALID}
    for kind, part in kinds.items():
        seen = {key for message in VALID if message["type"] == kind for key in message}
        assert seen | {"id"} == set(part["properties"]), kind


def test_what_the_schema_refuses_the_reader_refuses() -> None:
    random_, read_ones, refused = random.Random(11), 0, 0
    for _ in range(2000):
        message = edited(random_)
        try:
            number, values = decode_line(json.dumps(message).encode())
            read_request(values, DEVICE, EFFECTS, 1)
        except ControlError as error:
            refused += 1
            assert len(str(error)) < 1200
            continue
        read_ones += 1
        # A key with null for an id counts as no id.
        MESSAGE.validate({key: value for key, value in message.items() if key != "id" or number is not None})
    assert read_ones > 333 and refused > 333


# (a valid message of this kind with other keys, what the refusal says)
WRONG = [
    ({"type": "tap"}, "message: type: 'tap': expected one of hello, region"),
    (HELLO | {"version": 2}, "hello.version: 2: this run speaks version 1"),
    (HELLO | {"lease": "0.01 s"}, "hello.lease: '0.01 s': expected at least 0.1 s"),
    (HELLO | {"lease": "7200 s"}, "hello.lease: '7200 s': expected at most 3600 s"),
    (VALID[1] | {"region": ["10 kg", "20 mm"]}, "region.region: '10 kg' is a mass; expected a length"),
    (
        VALID[1] | {"rules": [{"on": "touch", "effect": "pres"}]},
        "region.rules[0].effect: 'pres': expected one of click",
    ),
    (VALID[1] | {"rules": [{"on": "touch", "effect": "press", "zones": ["I"]}]}, "leave 'zones' and 'region' out"),
    (VALID[1] | {"level_change": "louder"}, "region.level_change: 'louder': expected -80 to 80 dB"),
    ({"type": "region", "name": "ok", "rules": []}, "region.region: None: expected two positions"),
    ({"type": "define", "name": "x", "envelope": [["5 ms", "20 dB"]] * 17}, "define.envelope: 17: expected at most 16"),
    (VALID[5] | {"content": {"Pattern": [{"Event": {}}]}}, "define.content: Pattern[0].Event: {}: expected an object"),
    (VALID[5] | {"envelope": [["click", "20 dB"]]}, "define.envelope: [['click', '20 dB']]: unknown key"),
    (VALID[5] | {"content": {"Pattern": []}}, "filed: its file has no event that is felt"),
    ({"type": "trigger", "effect": "click", "finger": 1, "at": "1 mm"}, "give either a finger or 'at'"),
    ({"type": "trigger", "effect": "buzz", "at": "1 mm"}, "trigger.effect: 'buzz': is held, but at a place no finger"),
    ({"type": "trigger", "effect": "click", "at": "1 m"}, "trigger.at: '1 m': is off the bar, which is 279.4 mm long"),
    ({"type": "subscribe", "to": ["all"]}, "subscribe.to: ['all']: expected a list of touches, played"),
]


@pytest.mark.parametrize(("message", "expected"), WRONG, ids=[expected for _, expected in WRONG])
def test_what_is_wrong_is_refused_by_key_value_and_expectation(message: dict[str, object], expected: str) -> None:
    with pytest.raises(ControlError) as refused:
        read(message)
    assert expected in str(refused.value)


LONGEST = b'{"x": "' + b"x" * (MOST_BYTES - 9) + b'"}'
NO_MESSAGES = [b"", b"{", b"[]", b"NaN", b'{"type": Infinity}', b"\xff", b"[" * 9000, b'{"id": -1}', LONGEST + b" "]


@pytest.mark.parametrize("line", [*NO_MESSAGES, b'{"id": 9007199254740992}'])
def test_what_is_no_message_is_refused_and_what_is_as_long_and_as_large_as_may_be_is_read(line: bytes) -> None:
    with pytest.raises(ControlError, match=r"expected|no number"):
        decode_line(line)
    assert decode_line(LONGEST)[1]["x"][0] == "x"
    assert decode_line(b'{"id": 9007199254740991}') == (9007199254740991, {})
