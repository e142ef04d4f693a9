"""Messages for tests of the control channel: valid ones, edited ones, bytes that are none, and their schema."""

import copy
import json
import random
from pathlib import Path
from typing import Any

import jsonschema

from tactable.control.osc import Value, encode_osc

ROOT = Path(__file__).parents[3]
SCHEMA = json.loads((ROOT / "tables" / "schemas" / "control.schema.json").read_text(encoding="utf-8"))
MESSAGE = jsonschema.Draft202012Validator({"$ref": "#/$defs/message", "$defs": SCHEMA["$defs"]})
SAID = jsonschema.Draft202012Validator(
    {"oneOf": [{"$ref": "#/$defs/answer"}, {"$ref": "#/$defs/event"}], "$defs": SCHEMA["$defs"]}
)
"""What a run says to programs."""
HELLO: dict[str, Any] = {"type": "hello", "version": 1, "name": "a test"}
VALID: list[dict[str, Any]] = [
    HELLO | {"lease": "2 s"},
    {"type": "region", "name": "ok", "region": ["10 mm", "30 %"], "rules": [{"on": "touch", "effect": "press"}]},
    {
        "type": "region",
        "name": "scale",
        "zones": ["I", "III"],
        "rules": [
            {"on": "drag", "every": "5 mm", "effect": "tick"},
            {"on": "hold", "after": "1 s", "effect": "buzz"},
            {"on": "lift", "effect": "release"},
        ],
        "enabled": True,
        "level_change": "-6 dB",
        "stays": True,
    },
    {"type": "remove", "name": "ok"},
    {"type": "define", "name": "mine", "envelope": [["click", "20 dB"], ["50 ms", "quiet"], ["held", "full scale"]]},
    {
        "type": "define",
        "name": "filed",
        "format": "ahap",
        "level": "20 dB",
        "content": {"Pattern": [{"Event": {"Time": 0.1, "EventType": "HapticTransient", "EventParameters": []}}]},
    },
    {"type": "settings", "enabled": True, "rule_file": False, "level_change": "+3.5 dB"},
    {"type": "trigger", "effect": "click", "finger": 3},
    {"type": "trigger", "effect": "error", "at": "120 mm", "level_change": "6 dB"},
    {"type": "stop"},
    {"type": "role", "finger": 3, "role": "quiet"},
    {"type": "role", "finger": 3, "role": "by rules"},
    {"type": "subscribe", "to": ["touches", "played"]},
    {"type": "ping", "id": 7},
]
_ODD: list[Any] = [
    None, True, False, 0, -1, 3, 1e300, 1 << 60, "", "x", "3", "20 dB", "-6 dB", "5 mm", "1 s", "120 %", "press", "I",
    "\ud800", "a" * 300, [], ["10 mm", "20 mm"], ["20 mm", "10 mm"], ["I"], [[]], {}, {"on": "touch"},
    [{"on": "touch", "effect": "press"}],
]  # fmt: skip
_RAW = [
    b"", b"\xff\xfe", b"{", b"[]", b"3", b'"x"', b"nul", b"NaN", b'{"type": NaN}', b"[" * 5000,
    b'{"id": 1e999}', b"\x00",
]  # fmt: skip


def _odd(random_: random.Random) -> Any:
    return copy.deepcopy(random_.choice(_ODD))


def edited(random_: random.Random) -> dict[str, Any]:
    """A valid message after some edits, which may leave it valid."""
    message: dict[str, Any] = json.loads(json.dumps(random_.choice(VALID)))
    for _ in range(random_.choice((0, 0, 1, 1, 2, 4))):
        keys = [*message, random_.choice(("typ", "finger", "at", "zones", "region", "level_change", "id"))]
        key = random_.choice(keys)
        if random_.random() < 0.25:
            message.pop(key, None)
        elif random_.random() < 0.3 and isinstance(message.get(key), list) and message[key]:
            message[key][random_.randrange(len(message[key]))] = _odd(random_)
        else:
            message[key] = _odd(random_)
    return message


def hostile_line(random_: random.Random) -> bytes:
    """A line without its end: mostly an edited message, sometimes one that is broken or none at all."""
    kind = random_.random()
    if kind < 0.02:
        return random_.choice(_RAW)
    if kind < 0.03:
        return random_.randbytes(random_.randrange(200)).replace(b"\n", b" ")
    line = json.dumps(edited(random_)).encode()
    if kind < 0.05:
        at = random_.randrange(len(line))
        return line[:at] + random_.randbytes(1).replace(b"\n", b" ") + line[at + 1 :]
    return line


_OSC_NAMES = (
    "trigger", "trigger_at", "region", "remove", "settings", "quiet", "stop", "ping", "subscribe", "json", "", "x",
)  # fmt: skip
_OSC_VALUES: list[Value] = [
    0, 3, -1, 1 << 40, 20.0, -6.0, 1e30, float("nan"), True, False, None, "", "press", "touch", "ok", "played", b"x",
]  # fmt: skip


def hostile_datagram(random_: random.Random) -> bytes:
    """A datagram: a message as text or with odd arguments; some are changed, cut off or nested."""
    if random_.random() < 0.4:
        data = encode_osc("/tactable/json", [hostile_line(random_).decode("utf-8", "replace")])
    else:
        values = [random_.choice(_OSC_VALUES) for _ in range(random_.randrange(7))]
        data = encode_osc(f"/tactable/{random_.choice(_OSC_NAMES)}", values)
    while random_.random() < 0.3:
        size = len(data) if random_.random() < 0.8 else random_.choice((-4, 0, 3, 1 << 30))
        data = (
            b"#bundle\0"
            + random_.randbytes(8)
            + random_.choice((1, 2, 9)) * (size.to_bytes(4, "big", signed=True) + data)
        )
    changed = bytearray(data[:60_000])  # what UDP carries
    while random_.random() < 0.3:
        changed[random_.randrange(len(changed))] = random_.randrange(256)
    return bytes(changed if random_.random() < 0.9 else changed[: random_.randrange(len(changed))])
