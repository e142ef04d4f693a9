"""What the page's script sends and reads, encoded and decoded as it does it."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from base.arrays import Array
from engine.touch.sources.pointer import PointerEvent
from tactable.page.page_messages import _FINGER_NUMBER, _HEAD, _PHASES, _SIZE, _TOUCH, VERSION, Kind


def encode_touches(events: Sequence[PointerEvent]) -> bytes:
    """Encode a TOUCHES."""
    parts = (_TOUCH.pack(event.pointer_id, _PHASES.index(event.phase), event.x, event.y) for event in events)
    return _HEAD.pack(VERSION, Kind.TOUCHES) + b"".join(parts)


def encode_choice(switches: dict[str, Any]) -> bytes:
    """Encode a CHOICE."""
    return _HEAD.pack(VERSION, Kind.CHOICE) + json.dumps(switches).encode()


def encode_device(name: str, text: str) -> bytes:
    """Encode a DEVICE."""
    return _HEAD.pack(VERSION, Kind.DEVICE) + json.dumps({"name": name, "text": text}).encode()


def encode_listen(finger: int) -> bytes:
    """Encode a LISTEN."""
    return _HEAD.pack(VERSION, Kind.LISTEN) + _FINGER_NUMBER.pack(finger)


def decode_picture(message: bytes) -> tuple[dict[str, Any], Array]:
    """The values of a PICTURE, and its levels (kind, point) in dB."""
    (length,) = _SIZE.unpack_from(message, _HEAD.size)
    start = _HEAD.size + _SIZE.size
    told = json.loads(message[start : start + length])
    levels_db = np.frombuffer(message[start + length :], "<i2") / 100
    return told, levels_db.reshape(2 if told["paper"] is None else 4, -1)
