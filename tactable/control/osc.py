"""Programs that speak Open Sound Control: datagrams to a loopback port become messages of the control channel.

Each sender, an address and a port, is a program of its own with a lease of LEASE_S, renewed by whatever it sends. One
that holds nothing, such as a command that triggers a click, is forgotten at once, since each such command has a port of
its own; one that is silent for its lease is, too, and what it held ends. Answers and events go back to the sender's
port, or to the one that it named in a hello; whoever does not listen there misses them, so refusals are counted and
told at the end of the run too. OSC has no token: any program of this machine may send.

Messages are read and written by python-osc. Bundles (Open Sound Control 1.0, opensoundcontrol.org/spec-1_0) are taken
apart here, because `pythonosc.osc_packet` never ends for an element of negative size, sets no limit to nesting, and
only logs what it does not know. A time tag is passed over: what a bundle holds is for now.
"""

import asyncio
import ipaddress
import json
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any

from pythonosc.osc_message import OscMessage, ParseError
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.parsing import osc_types

from base.child import ChildError
from base.errors import TactableError
from base.printable import printable
from tactable.control.control_server import ControlServer
from tactable.control.requests import MOST_BYTES, VERSION
from tactable.control.security import LOOPBACK

LEASE_S = 30.0  # senders of OSC do not renew on their own: longer than the 5 s of programs that do
PREFIX = "/tactable/"
HELLO = f"{PREFIX}hello"
_MOST_WAITING = 256  # messages of one sender that were not answered yet; more are refused
MOST_MESSAGES = 64  # of one datagram
_DEEPEST = 4
_BUNDLE = b"#bundle\0"
_TIME_TAG_BYTES = 8
_TYPES = frozenset("ifsbhdTFN")  # those of the specification (i f s b) and its common extensions
Value = int | float | str | bytes | bool | None
Peer = tuple[str, int]
Document = dict[str, Any]


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


def message_of(address: str, values: Sequence[Value]) -> Document:
    """The message of an OSC address and its arguments. Raises OscError, which says what is expected."""
    name = address.removeprefix(PREFIX)
    if name == address or name not in _MESSAGES:
        raise OscError(f"{address}: expected one of {', '.join(PREFIX + each for each in _MESSAGES)}")
    expected, make = _MESSAGES[name]
    try:
        return make(*values)
    except (ValueError, TypeError, IndexError, KeyError, RecursionError):
        raise OscError(f"{address}: {list(values)!r:.80}: expected {expected}") from None


def _number(value: Value) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        raise ValueError(value)
    return float(value)


def _whole(value: Value) -> int:
    if (number := _number(value)) % 1:
        raise ValueError(value)
    return int(number)


def _switch(value: Value) -> bool:
    """On or off: T, F or a number; no text, since "0" and "off" would be true."""
    return value if isinstance(value, bool) else _number(value) != 0


def _place(value: Value) -> str:
    """A number of mm, or a text such as "60 x 40 mm" on a plate."""
    return value if isinstance(value, str) else f"{_number(value):.6f} mm"


def _change(level_change_db: Value = 0.0) -> dict[str, str]:
    return {"level_change": f"{_number(level_change_db):+.2f} dB"}


def _region(name: Value, start_mm: Value, stop_mm: Value, *rules: Value) -> Document:
    if not rules:
        raise ValueError(rules)
    listed = [{"on": on, "effect": effect} for on, effect in zip(rules[::2], rules[1::2], strict=True)]
    return {"type": "region", "name": name, "region": [_place(start_mm), _place(stop_mm)], "rules": listed}


def _settings(enabled: Value, rule_file: Value, *change: Value) -> Document:
    return {"type": "settings", "enabled": _switch(enabled), "rule_file": _switch(rule_file), **_change(*change)}


def _quiet(finger: Value, quiet: Value) -> Document:
    return {"type": "role", "finger": _whole(finger), "role": "quiet" if _switch(quiet) else "by rules"}


def _hello(port: Value) -> Document:
    if not 0 < _whole(port) < 1 << 16:
        raise ValueError(port)
    return {"type": "ping"}


def _json(text: Value) -> Document:
    if not isinstance(text, str) or not isinstance(message := json.loads(text), dict):
        raise TypeError
    return message


_MESSAGES: Mapping[str, tuple[str, Callable[..., Document]]] = {
    "trigger": (
        "effect, finger, and a change of level in dB if wanted",
        lambda effect, finger, *change: {
            "type": "trigger", "effect": effect, "finger": _whole(finger), **_change(*change),
        },
    ),
    "trigger_at": (
        "effect, place in mm or such as 60 x 40 mm, and a change of level in dB if wanted",
        lambda effect, at, *change: {"type": "trigger", "effect": effect, "at": _place(at), **_change(*change)},
    ),
    "region": ("name, start and stop in mm or as texts, then pairs of event and effect such as touch press", _region),
    "remove": ("the name of a region", lambda name: {"type": "remove", "name": name}),
    "settings": ("enabled, rule_file (0 or 1), and a change of level in dB if wanted", _settings),
    "quiet": ("finger, and 1 for quiet or 0 for by rules", _quiet),
    "hello": ("the port that answers and events are to go to", _hello),
    "stop": ("nothing", lambda *_: {"type": "stop"}),
    "ping": ("nothing", lambda *_: {"type": "ping"}),
    "subscribe": ("touches, played, both or nothing", lambda *streams: {"type": "subscribe", "to": list(streams)}),
    "json": ("a message of the control channel as text", _json),
}  # fmt: skip
"""By address, the arguments that are expected, and the message that they make."""


class _Sender:
    """One sender: its messages as lines, and the way back to it."""

    def __init__(self, owner: "OscControl", peer: Peer) -> None:
        self._owner, self._peer = owner, peer
        self.reply_to = peer
        self._lines: asyncio.Queue[bytes] = asyncio.Queue(_MOST_WAITING)
        self._asked = deque([PREFIX])
        hello = {"type": "hello", "version": VERSION, "name": f"OSC {peer[1]}", "lease": f"{LEASE_S:g} s"}
        self._lines.put_nowait(json.dumps(hello).encode())

    def take_message(self, address: str, message: Document) -> None:
        """Put a message into the line. Raises OscError where too many wait."""
        try:
            self._lines.put_nowait(json.dumps(message).encode())
        except asyncio.QueueFull:
            raise OscError(f"{address}: {_MOST_WAITING} messages wait for their answers: send fewer") from None
        self._asked.append(address)

    async def lines(self) -> AsyncIterator[bytes]:
        """Lines as they come, until the sender holds nothing any more or is silent for its lease."""
        # Until all was answered and the sender may be forgotten at once.
        while self._asked or self.reply_to != self._peer or not self._owner.server.let_go(self):
            try:
                # `asyncio.wait_for` of Python 3.11 forgets that it was cancelled when a line comes at that moment.
                async with asyncio.timeout(LEASE_S):
                    line = await self._lines.get()
            except TimeoutError:
                break
            yield line
        self._owner.forget(self._peer, self)

    def send(self, line: bytes) -> None:
        document = json.loads(line)
        if "answer" in document:
            address = self._asked.popleft() if self._asked else ""
            if address == PREFIX and document["ok"]:
                return
            self._owner.answer(self.reply_to, address, document.get("error"))
            if "fingers" in document:  # of a subscription: those that touch now
                self._send_touches(document["fingers"])
        elif document["event"] == "touches":
            self._send_touches(document["fingers"])
        elif document["event"] == "played":
            level_db = -1.0 if document["level_db"] is None else float(document["level_db"])
            self._owner.send(self.reply_to, "played", [document["kind"], level_db, document["effect"] or ""])
        else:
            self._owner.send(self.reply_to, "event", [json.dumps(document)])

    def _send_touches(self, fingers: list[dict[str, Any]]) -> None:
        values = list[Value]()
        for each in fingers:
            at_m = each["at_m"]
            values += each["finger"], *(1e3 * side_m for side_m in (at_m if isinstance(at_m, list) else [at_m]))
        self._owner.send(self.reply_to, "touches", values)

    async def drain(self) -> None:
        """A datagram is gone at once."""

    def unread_bytes(self) -> int:
        return 0


class OscControl(asyncio.DatagramProtocol):
    """The OSC port of one control server; `open` binds it."""

    def __init__(self, server: ControlServer) -> None:
        self.server = server
        self._transport: asyncio.DatagramTransport | None = None
        self._senders: dict[Peer, _Sender] = {}
        self._talks = set[asyncio.Task[None]]()
        self.messages = self.refused = 0
        self.last_error = ""

    async def open(self, port: int) -> int:
        """Bind the port on loopback, 0 for any; the port. Raises ChildError for one that is taken."""
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(LOOPBACK[0], port))
        except OSError as error:
            raise ChildError(f"port {port}: no OSC can be heard there ({error}): choose another one") from error
        bound: int = self._transport.get_extra_info("sockname")[1]
        return bound

    @property
    def summary(self) -> str:
        """Counts of the messages received, for the end of the run."""
        last = f"; the last: {printable(self.last_error)}" if self.last_error else ""
        return f"OSC: {self.messages} messages, {self.refused} refused{last}"

    async def close(self) -> None:
        """End all senders and the port."""
        for talk in self._talks:
            talk.cancel()
        await asyncio.gather(*self._talks, return_exceptions=True)
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, addr: Peer) -> None:
        """Take the messages of one datagram; whatever is wrong with one is answered, but to no other machine."""
        if not ipaddress.ip_address(addr[0]).is_loopback:
            self.messages += 1
            self.refused += 1
            self.last_error = f"a datagram from {addr[0]}: programs of this machine alone may send"
            return
        try:
            messages = decode_osc(data)
        except OscError as error:
            self.messages += 1
            self.answer(addr, "", str(error))
            return
        for address, values in messages:
            self.messages += 1
            try:
                message = message_of(address, values)
                sender = self._sender(addr)
                if address == HELLO:
                    sender.reply_to = addr[0], _whole(values[0])
                sender.take_message(address, message)
            except (OscError, ValueError, TypeError) as error:
                self.answer(addr, address, str(error))

    def answer(self, peer: Peer, address: str, error: str | None) -> None:
        """Tell a sender what became of a message."""
        if error is not None:
            self.refused += 1
            self.last_error = error
        self.send(peer, "answer", [address, error is None, error or ""])

    def send(self, peer: Peer, name: str, values: Sequence[Value]) -> None:
        """Send a message to a sender's port."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(encode_osc(PREFIX + name, values), peer)

    def _sender(self, peer: Peer) -> _Sender:
        sender = self._senders.get(peer)
        if sender is None:
            sender = self._senders[peer] = _Sender(self, peer)
            talk = asyncio.ensure_future(self.server.converse(sender.lines(), sender))
            self._talks.add(talk)
            talk.add_done_callback(lambda _: self.forget(peer, sender))
            talk.add_done_callback(self._talks.discard)
        return sender

    def forget(self, peer: Peer, sender: _Sender) -> None:
        """Drop a sender, so that its address begins a new program when it sends again."""
        if self._senders.get(peer) is sender:
            del self._senders[peer]
