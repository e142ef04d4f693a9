"""Open Sound Control 1.0 (opensoundcontrol.org/spec-1_0): datagrams to messages and back, pure.

The types are those of the specification (i f s b) and of its common extensions (h d T F N). A time tag is passed over:
what a bundle holds is for now.
"""

import struct
from collections.abc import Sequence

from firmware_link.protocol.errors import TactableError

MOST_MESSAGES = 64
"""Of one datagram."""
_DEEPEST = 4
_BUNDLE = b"#bundle\0"
_NUMBERS = {"i": struct.Struct(">i"), "f": struct.Struct(">f"), "h": struct.Struct(">q"), "d": struct.Struct(">d")}
_WORDS = {"T": True, "F": False, "N": None}
Value = int | float | str | bytes | bool | None


class OscError(TactableError, ValueError):
    """A datagram that is no OSC; the text says where it breaks off."""


def decode_osc(data: bytes, depth: int = 0) -> list[tuple[str, list[Value]]]:
    """Address and arguments of each message of a datagram. Raises OscError."""
    if data.startswith(_BUNDLE):
        messages: list[tuple[str, list[Value]]] = []
        at = len(_BUNDLE) + 8  # the time tag
        if len(data) < at or depth == _DEEPEST:
            raise OscError(f"a bundle of {len(data)} bytes, {depth} deep: expected a time tag, and at most {_DEEPEST}")
        while at < len(data):
            size = _unpack("i", data, at)[0]
            if size <= 0 or at + 4 + size > len(data):
                raise OscError(f"byte {at}: an element of {size} bytes; expected at most {len(data) - at - 4}")
            messages += decode_osc(data[at + 4 : at + 4 + size], depth + 1)
            if len(messages) > MOST_MESSAGES:
                raise OscError(f"more than {MOST_MESSAGES} messages in a datagram")
            at += 4 + size
        return messages
    address, at = _text(data, 0)
    if not address.startswith("/"):
        raise OscError(f"{address!r:.40}: expected an address that begins with /")
    tags, at = _text(data, at) if at < len(data) else (",", at)  # old senders leave the tags of no arguments out
    if not tags.startswith(","):
        raise OscError(f"{address}: byte {at}: expected type tags that begin with a comma")
    values: list[Value] = []
    for tag in tags[1:]:
        if tag in _WORDS:
            values.append(_WORDS[tag])
        elif tag in _NUMBERS:
            value, at = _unpack(tag, data, at)
            values.append(value)
        elif tag in "sS":
            text, at = _text(data, at)
            values.append(text)
        elif tag == "b":
            size, at = _unpack("i", data, at)
            if size < 0 or at + size > len(data):
                raise OscError(f"{address}: byte {at}: a blob of {size} bytes; there are {len(data) - at}")
            values.append(data[at : at + size])
            at += _padded(size)
        else:
            raise OscError(f"{address}: type {tag!r} is not known; expected of i, f, s, b, h, d, T, F, N")
    return [(address, values)]


def encode_osc(address: str, values: Sequence[Value]) -> bytes:
    """One message as a datagram; whole numbers travel as i, others as f."""
    tags, parts = ",", []
    for value in values:
        if value is None or isinstance(value, bool):
            tags += "N" if value is None else "T" if value else "F"
        elif isinstance(value, int):
            tags += "i"
            parts.append(_NUMBERS["i"].pack(value))
        elif isinstance(value, float):
            tags += "f"
            parts.append(_NUMBERS["f"].pack(value))
        elif isinstance(value, str):
            tags += "s"
            parts.append(_string(value))
        else:
            tags += "b"
            parts.append(_NUMBERS["i"].pack(len(value)) + value.ljust(_padded(len(value)), b"\0"))
    return b"".join((_string(address), _string(tags), *parts))


def _padded(size: int) -> int:
    return size + -size % 4


def _string(text: str) -> bytes:
    data = text.encode("utf-8", "replace").replace(b"\0", b"?")
    return data.ljust(_padded(len(data) + 1), b"\0")


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at)
    if end < 0:
        raise OscError(f"byte {at}: a text without an end")
    try:
        return data[at:end].decode("utf-8"), at + _padded(end - at + 1)
    except UnicodeDecodeError:
        raise OscError(f"byte {at}: a text that is not UTF-8") from None


def _unpack(tag: str, data: bytes, at: int) -> tuple[int, int]:
    number = _NUMBERS[tag]
    if at + number.size > len(data):
        raise OscError(f"byte {at}: the datagram ends within an argument of type {tag}")
    return number.unpack_from(data, at)[0], at + number.size
