"""Open Sound Control 1.0 (opensoundcontrol.org/spec-1_0): datagrams to messages and back, pure.

Messages are read and written by python-osc. Bundles are taken apart here, because `pythonosc.osc_packet` never ends for
an element of negative size, sets no limit to nesting, and only logs what it does not know. A time tag is passed over:
what a bundle holds is for now.
"""

from collections.abc import Sequence

from pythonosc.osc_message import OscMessage, ParseError
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.parsing import osc_types

from base.errors import TactableError
from tactable.control.requests import MOST_BYTES

MOST_MESSAGES = 64  # of one datagram
_DEEPEST = 4
_BUNDLE = b"#bundle\0"
_TIME_TAG_BYTES = 8
_TYPES = frozenset("ifsbhdTFN")  # those of the specification (i f s b) and its common extensions
Value = int | float | str | bytes | bool | None


class OscError(TactableError, ValueError):
    """A datagram that is no OSC; the text says what is wrong."""


def decode_osc(data: bytes, depth: int = 0) -> list[tuple[str, list[Value]]]:
    """Address and arguments of each message of a datagram. Raises OscError."""
    if len(data) > MOST_BYTES:
        raise OscError(f"a datagram of {len(data)} bytes; expected at most {MOST_BYTES}")
    if not data.startswith(_BUNDLE):
        return [_decode_message(data)]
    messages: list[tuple[str, list[Value]]] = []
    at = len(_BUNDLE) + _TIME_TAG_BYTES
    if len(data) < at or depth == _DEEPEST:
        raise OscError(f"a bundle of {len(data)} bytes, {depth} deep: expected a time tag, and at most {_DEEPEST}")
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big", signed=True)
        at += 4
        if size <= 0 or at + size > len(data):
            raise OscError(f"byte {at - 4}: an element of {size} bytes; expected 4 to {max(len(data) - at, 4)}")
        messages += decode_osc(data[at : at + size], depth + 1)
        if len(messages) > MOST_MESSAGES:
            raise OscError(f"more than {MOST_MESSAGES} messages in a datagram")
        at += size
    return messages


def _decode_message(data: bytes) -> tuple[str, list[Value]]:
    if not OscMessage.dgram_is_message(data):
        raise OscError(f"{data[:40]!r}: expected an address that begins with /")
    if len(data) % 4:  # python-osc would fill a number that was cut off with zeros
        raise OscError(f"{data[:40]!r}: {len(data)} bytes; a message has a multiple of 4")
    try:
        address, at = osc_types.get_string(data, 0)
        tags = osc_types.get_string(data, at)[0] if at < len(data) else ","  # old senders leave them out
        if unknown := set(tags[1:]) - _TYPES:  # python-osc would pass over their values
            raise OscError(f"{address}: type {min(unknown)!r} is not known; expected of {', '.join(sorted(_TYPES))}")
        return address, OscMessage(data).params
    except (ParseError, osc_types.ParseError, UnicodeDecodeError) as error:
        raise OscError(f"{data[:40]!r}: no message of OSC: {error}") from None


def encode_osc(address: str, values: Sequence[Value]) -> bytes:
    """One message as a datagram; whole numbers travel as i, or as h where they are large, other numbers as f."""
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(_writable(value) if isinstance(value, str) else value)
    return builder.build().dgram


def _writable(text: str) -> str:
    """The text with a question mark for what UTF-8 does not have, and for NUL, which would end it."""
    return text.encode("utf-8", "replace").decode().replace("\0", "?")
