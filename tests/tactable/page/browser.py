"""What the page's script sends, encoded as it does it."""

import json
from collections.abc import Sequence
from typing import Any

from engine.touch.sources.pointer import PointerEvent
from tactable.page.page_messages import _FINGER_NUMBER, _HEAD, _PHASES, _TOUCH, VERSION, Kind


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
