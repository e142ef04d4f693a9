"""Open Sound Control: bytes as the specification has them, messages of the channel, and an answer to every sender."""

import asyncio
import random
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactable.control.control_server import ControlServer
from tactable.control.osc import (
    _DEEPEST,
    _MESSAGES,
    PREFIX,
    OscControl,
    OscError,
    Value,
    _Sender,
    decode_osc,
    encode_osc,
    message_of,
)
from tactable.control.requests import MOST_BYTES, read_request
from tactable.shipped import find_device, named_effects
from tests.tactable.control.messages import MESSAGE, hostile_datagram
from tests.tactable.control.virtual import FINGERS, VirtualSlot, on_virtual_time, server_of, settle

VALUES = st.one_of(
    st.integers(-(1 << 31), (1 << 31) - 1), st.floats(width=32, allow_nan=False), st.booleans(), st.none(),
    st.binary(min_size=1, max_size=9), st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9),
)  # fmt: skip
ASKED: dict[str, list[Value]] = {
    "trigger": ["press", 3, -6.0],
    "trigger_at": ["error", 120.5],
    "remove": ["ok"],
    "settings": [1, False, 3],
    "region": ["ok", 20, 60.0, "touch", "press", "lift", "release"],
    "quiet": [3, 1],
    "hello": [9001],
    "stop": [],
    "json": ['{"type": "define", "name": "mine", "envelope": [["click", "20 dB"]]}'],
    "ping": [],
    "subscribe": ["touches", "played"],
}


def bundle_of(data: bytes, times: int = 1) -> bytes:
    return b"#bundle\0" + bytes(8) + times * (len(data).to_bytes(4, "big") + data)


def test_the_examples_of_the_specification() -> None:
    assert encode_osc("/oscillator/4/frequency", [440.0]).hex() == (
        "2f6f7363696c6c61746f722f342f6672657175656e6379002c66000043dc0000"
    )
    whole = bytes.fromhex("2f666f6f000000002c69697366660000000003e8ffffffff68656c6c6f0000003f9df3b640b5b22d")
    ((address, values),) = decode_osc(whole)
    assert (address, values[:3]) == ("/foo", [1000, -1, "hello"])
    assert values[3:] == pytest.approx([1.234, 5.678])
    assert encode_osc(address, values) == whole


@given(st.lists(VALUES, max_size=8))
def test_what_is_written_is_read(values: list[Value]) -> None:
    data = encode_osc("/a/b", values)
    assert len(data) % 4 == 0 and decode_osc(data) == [("/a/b", values)]
    assert decode_osc(bundle_of(data, 2)) == 2 * [("/a/b", values)]


def test_the_longest_datagram_is_read_and_one_that_is_longer_is_refused() -> None:
    head = len(encode_osc("/a", [b"four"])) - 4
    longest = encode_osc("/a", [bytes(MOST_BYTES - head)])
    assert len(longest) == MOST_BYTES and decode_osc(longest) == [("/a", [bytes(MOST_BYTES - head)])]
    with pytest.raises(OscError, match=f"at most {MOST_BYTES}"):
        decode_osc(encode_osc("/a", [bytes(MOST_BYTES - head + 4)]))


@pytest.mark.parametrize("data", [b"", b"x\0\0\0,\0\0\0", b"\xff\0\0\0", b"/x\0\0,i\0\0", b"/x\0\0,s\0\0\xff\0\0\0"])
def test_bytes_that_are_no_message_are_refused_and_types_that_are_not_known_named(data: bytes) -> None:
    with pytest.raises(OscError):
        decode_osc(data)
    for tags in (b",S\0\0", b",[]\0", b",I\0\0"):
        with pytest.raises(OscError, match=r"/x: type '.' is not known"):
            decode_osc(b"/x\0\0" + tags + b"y\0\0\0")


def test_what_no_text_of_osc_may_hold_is_a_question_mark_and_large_numbers_are_whole() -> None:
    data = encode_osc("/x", ["a\ud800b\0c", 1 << 40])
    assert decode_osc(data) == [("/x", ["a?b?c", 1 << 40])]


def test_a_datagram_that_would_never_end_or_is_too_much_is_refused() -> None:
    number = encode_osc("/tactable/trigger_at", ["press", 83.7])
    for cut in (1, 2, 3):
        with pytest.raises(OscError, match="a multiple of 4"):
            decode_osc(number[:-cut])
    for size in (-4, 0, 9):
        with pytest.raises(OscError, match=f"byte 16: an element of {size} bytes"):
            decode_osc(b"#bundle\0" + bytes(8) + size.to_bytes(4, "big", signed=True) + bytes(8))
    nested = message = encode_osc("/x", [])
    assert len(decode_osc(bundle_of(message, 64))) == 64
    with pytest.raises(OscError, match="more than 64 messages"):
        decode_osc(bundle_of(message, 65))
    for _ in range(_DEEPEST):
        nested = bundle_of(nested)
    assert len(decode_osc(nested)) == 1
    with pytest.raises(OscError, match="deep"):
        decode_osc(bundle_of(nested))


@pytest.mark.parametrize("name", _MESSAGES)
def test_each_address_is_a_message_of_the_channel(name: str) -> None:
    message = message_of(PREFIX + name, ASKED[name])
    MESSAGE.validate(message)
    read_request(message, find_device("reference-a"), named_effects(), 1)


@pytest.mark.parametrize("switch", [1, 0.5, True, 0, False])
def test_a_switch_is_a_truth_or_a_number(switch: Value) -> None:
    assert message_of(f"{PREFIX}quiet", [3, switch])["role"] == ("quiet" if switch else "by rules")


def test_places_on_a_plate_are_texts_and_touches_there_have_both_coordinates() -> None:
    asked: dict[str, list[Value]] = {
        "trigger_at": ["error", "60 x 40 mm"],
        "region": ["ok", "20 x 10 mm", "60 x 50 mm", "touch", "press"],
    }
    for name, values in asked.items():
        message = message_of(PREFIX + name, values)
        MESSAGE.validate(message)
        read_request(message, find_device("reference-p"), named_effects(), 1)
    sent = list[Any]()
    sender = _Sender(cast("OscControl", SimpleNamespace(send=lambda *what: sent.append(what))), ("127.0.0.1", 9))
    sender._send_touches([{"finger": 1, "at_m": [0.06, 0.04]}])
    assert sent == [(("127.0.0.1", 9), "touches", [1, 60.0, 40.0])]


@pytest.mark.parametrize(
    ("address", "values", "expected"),
    [
        ("/tactable/tap", [], "expected one of /tactable/trigger, "),
        ("/other", [], "expected one of /tactable/trigger, "),
        ("/tactable/trigger", ["press", "x"], r"\['press', 'x'\]: expected effect, finger"),
        ("/tactable/trigger", ["press", 1.5], r"\['press', 1.5\]: expected effect, finger"),
        ("/tactable/region", ["ok", 1, 2, "touch"], "then pairs of event and effect"),
        ("/tactable/settings", ["0", 1], "expected enabled, rule_file"),
        ("/tactable/quiet", [3, "off"], "expected finger, and 1 for quiet or 0"),
        ("/tactable/settings", [float("nan"), 1], "expected enabled, rule_file"),
        ("/tactable/hello", [0], "expected the port"),
        ("/tactable/hello", [1 << 16], "expected the port"),
        ("/tactable/json", [b"{}"], "expected a message of the control channel"),
        ("/tactable/json", ["[]"], "expected a message of the control channel"),
        ("/tactable/json", ["[" * 5000], "expected a message of the control channel"),
    ],
)
def test_what_is_wrong_is_refused_by_address_and_expectation(address: str, values: list[Value], expected: str) -> None:
    with pytest.raises(OscError, match=expected):
        message_of(address, values)


class Port(asyncio.DatagramTransport):
    def __init__(self) -> None:
        super().__init__()
        self.said: dict[Any, list[tuple[str, list[Value]]]] = {}

    def sendto(self, data: Any, addr: Any = None) -> None:
        self.said.setdefault(addr, []).extend(decode_osc(bytes(data)))

    def is_closing(self) -> bool:
        return False

    def close(self) -> None:
        pass


@pytest.fixture
def osc(server: ControlServer) -> OscControl:
    return OscControl(server)


@on_virtual_time
async def test_every_sender_is_a_program_that_is_answered_and_hears_what_it_asked_for(
    osc: OscControl, server: ControlServer, slot: VirtualSlot
) -> None:
    osc._transport = port = Port()
    assert osc.summary == "OSC: 0 messages, 0 refused"
    first, second = ("127.0.0.1", 7), ("127.0.0.1", 8)
    triggers: list[list[Value]] = [["tick", 3], ["tick", 9], ["x"]]
    for name, values in (("region", ASKED["region"]), *(("trigger", each) for each in triggers)):
        osc.datagram_received(encode_osc(PREFIX + name, values), first)
    await settle()
    answers = port.said.pop(first)
    assert all(address == f"{PREFIX}answer" for address, _ in answers)
    assert sorted(bool(values[1]) for _, values in answers) == [False, False, True, True]
    assert any("trigger.finger: 9: does not touch the bar" in str(values[2]) for _, values in answers)
    assert list(server.scene.regions) == ["ok"] and len(slot.steps) == 3
    osc.datagram_received(encode_osc(f"{PREFIX}subscribe", ["touches", "played"]), second)
    await settle()
    server.publish([{"event": "touches", "time_ns": 1, "fingers": 2 * FINGERS}])
    for level_db in (None, 20.0):
        server.publish([{"event": "played", "kind": "drive", "effect": "tick", "level_db": level_db}])
    osc.datagram_received(b"nonsense", second)
    answer, now, later, *played, refusal = port.said[second]
    assert played == [(f"{PREFIX}played", ["drive", level_db, "tick"]) for level_db in (-1.0, 20.0)]
    assert answer[1][1] is True and now == (f"{PREFIX}touches", [3, 50.0])  # those that touch now, in mm
    assert later == (f"{PREFIX}touches", [3, 50.0, 3, 50.0]) and refusal[1][1] is False
    assert osc.summary.startswith("OSC: 6 messages, 3 refused; the last: b'nonsense'")
    await osc.close()
    assert server.scene.regions == {} and first not in port.said


@pytest.mark.parametrize(("host", "is_heard"), [("127.0.0.1", True), ("192.168.1.2", False), ("8.8.8.8", False)])
@on_virtual_time
async def test_only_programs_of_this_machine_are_heard(osc: OscControl, host: str, is_heard: bool) -> None:
    for data in (encode_osc(f"{PREFIX}ping", []), b"nonsense"):
        osc.datagram_received(data, (host, 9))
    await settle()
    assert (osc.messages, osc.refused) == ((2, 1) if is_heard else (2, 2)) and not osc._senders  # a ping holds nothing
    assert (host in osc.last_error) is not is_heard
    await osc.close()


@on_virtual_time
async def test_commands_that_trigger_and_end_take_no_place_from_others(
    osc: OscControl, server: ControlServer, slot: VirtualSlot
) -> None:
    """As a loop of `oscsend` does; a click that was triggered so plays on."""
    osc._transport = port = Port()
    for number in range(100):
        osc.datagram_received(encode_osc(f"{PREFIX}trigger", ["press", 3]), ("127.0.0.1", 1000 + number))
        await settle()
    assert not server._programs and not osc._senders and osc.refused == 0
    assert len(slot.steps) == 100 and slot.player.wanted.level_db is not None
    osc.datagram_received(encode_osc(f"{PREFIX}trigger", ["buzz", 3]), ("127.0.0.1", 1))  # it does not end by itself
    osc.datagram_received(encode_osc(f"{PREFIX}hello", [9001]), ("127.0.0.1", 2))
    await settle()
    assert len(server._programs) == 2 and ("127.0.0.1", 9001) in port.said and ("127.0.0.1", 2) not in port.said
    await osc.close()


@pytest.mark.usefixtures("both_ends")
@on_virtual_time
async def test_the_port_is_on_loopback(osc: OscControl) -> None:
    await osc.open(0)
    assert osc._transport is not None and osc._transport.get_extra_info("sockname")[0] == "127.0.0.1"
    await osc.close()


@on_virtual_time
async def test_a_sender_silent_for_its_lease_is_forgotten_with_what_it_held(osc: OscControl, slot: VirtualSlot) -> None:
    asked: dict[str, list[Value]] = {"trigger": ["buzz", 3], "region": ASKED["region"]}
    for name, values in asked.items():
        osc.datagram_received(encode_osc(PREFIX + name, values), ("127.0.0.1", 9))
    await settle()
    await asyncio.sleep(29.7)
    osc.datagram_received(encode_osc(f"{PREFIX}ping", []), ("127.0.0.1", 9))
    await asyncio.sleep(29.7)
    assert slot.player.wanted.level_db is not None and slot.decoder.scene.rules and osc._senders
    await asyncio.sleep(0.6)
    await settle()
    assert slot.player.wanted.level_db is None and slot.decoder.scene.rules == () and not osc._senders
    await osc.close()


@on_virtual_time
async def test_whatever_a_datagram_holds_it_is_taken_or_refused_and_the_next_one_is_heard(osc: OscControl) -> None:
    random_, peer = random.Random(7), ("127.0.0.1", 7)
    osc._transport = port = Port()
    for _ in range(1000):
        osc.datagram_received(hostile_datagram(random_), peer)
        await settle()
    assert 100 < osc.refused < osc.messages - 100
    osc.datagram_received(encode_osc(f"{PREFIX}ping", []), peer)
    await settle()
    assert port.said[peer][-1] == (f"{PREFIX}answer", [f"{PREFIX}ping", True, ""])
    await osc.close()


@on_virtual_time
async def test_of_a_flood_what_does_not_wait_is_refused() -> None:
    osc = OscControl(server_of(VirtualSlot()))
    for _ in range(300):
        osc.datagram_received(encode_osc(f"{PREFIX}stop", []), ("127.0.0.1", 9))
    assert osc.refused == 300 - 255 and "send fewer" in osc.last_error  # its hello is the 256th
    await osc.close()
