"""The compiled step against the loop: the same commands, byte by byte, and what is not its own is left alone."""

from __future__ import annotations

import contextlib
import ctypes
import socket
import stat
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.effects import Effect, Effects, Rule, Segment, Trigger
from engine.effects.rules import click
from engine.loop import Dispatcher, SystemClock, open_pipeline
from engine.loop.fast.fast_path import FastPath
from engine.loop.fast.library import FastPathError, compile_fast_path
from engine.loop.fast.table import MOST_CELLS, with_fast_table
from engine.touch.descriptor import read_surfaces
from engine.touch.sources.recording import read_recording
from tactable.bench.latency.sockets import SocketPort
from tests.engine.loop.fast.virtual_fast_path import Packets
from tests.engine.loop.rig import DEVICE, HELD, Rig, entry_for, held, index_of, recording_of, report
from tests.engine.made_clicks import click_of
from tests.engine.made_entries import LEVEL_DB, states_of
from tests.engine.shared_recordings import recording_params

MS = 1_000_000
LOUD_DB = LEVEL_DB + 6.0
CLICKS = [click_of(DEVICE, states_of(DEVICE, felt, quiet), level_db=26.0) for felt, quiet in (([0], []), ([2], [0]))]
ENTRIES = [entry_for(*zones, level_db=level) for zones in ((0,), (2,), (4,), (0, 2)) for level in (LEVEL_DB, LOUD_DB)]
FELT = Effect("held", (Segment(None, LEVEL_DB),))
LOUD = Effect("loud", (Segment(40 * MS, None), Segment(30 * MS, LOUD_DB)))


@pytest.fixture(scope="module")
def library(fast_library: ctypes.CDLL) -> ctypes.CDLL:
    return fast_library


class FastRig(Rig):
    """With the fast path."""


def both(library: ctypes.CDLL, *frames: tuple[float, bytes], effects: Effects = HELD, speed: float = 1.0) -> Rig:
    """The run with the fast path, which does what the one without does."""
    FastRig.library = library
    slow, fast = (
        rig(recording_of(*frames), effects=effects, clicks=CLICKS, entries=ENTRIES, speed=speed).run()
        for rig in (Rig, FastRig)
    )
    assert fast.trace == slow.trace
    assert fast.log == slow.log
    assert fast.loop.counters == slow.loop.counters
    return fast


def test_what_most_touches_bring_is_answered(library: ctypes.CDLL) -> None:
    two = [(1, 0.1), (2, 0.5)]
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.2, *two), (0.2, report((2, 0.5), lifted=[1]))]
    rig = both(library, *frames, (0.25, report(lifted=[2])))
    assert rig.session.fast_counters.answered == 3  # before the first the line is busy: it was only just armed
    assert rig.loop.counters.commands == 4


def test_clicks_are_answered(library: ctypes.CDLL) -> None:
    effects = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))
    frames = [(0.0, report()), (0.1, report((1, 0.1))), (0.2, report((1, 0.1), (2, 0.5))), (0.3, report())]
    rig = both(library, *frames, effects=effects)
    assert rig.session.fast_counters.answered == 2


PLACES = st.sampled_from([0.0, 0.1, 0.19, 0.201, 0.3, 0.399, 0.5, 0.7, 0.9, 1.0])
TOUCHES = st.dictionaries(st.integers(1, 4), PLACES, max_size=2)
SCRIPTS = st.lists(st.tuples(st.sampled_from([0.002, 0.008, 0.03, 0.2]), TOUCHES), min_size=1, max_size=12)
RULES = st.lists(
    st.builds(
        Rule,
        st.sampled_from(list(Trigger)),
        st.sampled_from([FELT, LOUD, click(LEVEL_DB), click(LOUD_DB)]),
        zones=st.sampled_from([None, frozenset({0}), frozenset({1, 2})]),
        region_m=st.sampled_from([None, (0.0, 0.1)]),
        after_ns=st.just(20 * MS),
        every_m=st.just(0.01),
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(SCRIPTS, RULES)
def test_whatever_fingers_do_and_rules_say_the_run_is_the_same(
    library: ctypes.CDLL, script: list[tuple[float, dict[int, float]]], rules: Sequence[Rule]
) -> None:
    time_s, frames, before = 0.0, list[tuple[float, bytes]](), dict[int, float]()
    for pause_s, touches in script:
        lifted = [contact for contact in before if contact not in touches][: 2 - len(touches)]
        frames.append((time_s, report(*touches.items(), lifted=lifted)))
        time_s, before = time_s + pause_s, touches
    both(library, *frames, effects=Effects(tuple(rules)))


@pytest.mark.parametrize("path", recording_params("touch", "*.hid"))
def test_a_recorded_device_is_answered_as_the_loop_does(library: ctypes.CDLL, path: Path) -> None:
    recording = read_recording(path)
    if not read_surfaces(recording.descriptor):
        pytest.skip("no touch surface")
    FastRig.library = library
    rigs = [rig(replace(recording, reports=recording.reports[:400]), speed=8.0) for rig in (Rig, FastRig)]
    slow, fast = (rig.run() for rig in rigs)
    assert fast.trace == slow.trace
    assert fast.log == slow.log


class Sockets(Packets):
    """Packets of a real socket."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(recording_of((0.0, report())))
        self._descriptor = descriptor

    def packet_fileno(self) -> int:
        return self._descriptor


@pytest.mark.parametrize("waiting", [1, 2])
def test_a_report_that_is_not_the_last_is_left_to_the_loop(library: ctypes.CDLL, waiting: int) -> None:
    rig = Rig(recording_of((0.0, report())))
    kind = socket.SOCK_SEQPACKET
    with contextlib.ExitStack() as stack:
        pairs = [socket.socketpair(socket.AF_UNIX, kind) for _ in range(2)]
        (ours, touch), (device, port) = [[stack.enter_context(end) for end in pair] for pair in pairs]
        source, clock, session = Sockets(touch.fileno()), SystemClock(), rig.session
        session.port = SocketPort(port.fileno())
        pipeline, dispatcher = open_pipeline(source, DEVICE, HELD, rig.renderer), Dispatcher(session, clock.now_ns)
        fast = FastPath(library, source, pipeline, dispatcher, clock, HELD, rig.rendering)
        for place in (0.1, 0.5)[:waiting]:
            ours.send(struct.pack("<qq", clock.now_ns(), 0) + report((1, place)))
        readable = fast.wait(None, (touch.fileno(), port.fileno()), ())
        device.setblocking(False)
        assert readable is not None and touch.fileno() in readable and port.fileno() not in readable
        assert fast.source.taken is not None
        if waiting == 1:
            assert session.answer is not None
            assert session.answer.frame == device.recv(4096)
            assert session.answer.written == len(session.answer.frame)
            return
        assert session.answer is None
        with pytest.raises(BlockingIOError):
            device.recv(4096)


def test_a_wrong_answer_is_put_right_and_the_last(library: ctypes.CDLL) -> None:
    FastRig.library = library
    frames = [*held(0.0, 0.5, (1, 0.1)), *held(0.5, 1.0, (1, 0.5)), (1.0, report(lifted=[1]))]
    rig = FastRig(recording_of(*frames), reconnect=True)
    assert rig.rendering.fast_table is not None
    rig.rendering.fast_table.commands["body"][:, 8] ^= 0x40
    rig.loop.run()
    counters = rig.session.fast_counters
    assert (counters.mispredicted, counters.answered) == (1, 0)
    assert [index for index in rig.states() if index] == [index_of(0), index_of(2)]
    assert rig.played()[-2:] == [104.0, 0.0]


def test_too_many_states_for_a_table_take_the_long_way() -> None:
    rig = Rig(recording_of((0.0, report())))
    assert rig.session.link.capabilities is not None
    zones = tuple(replace(DEVICE.zones[0], name=str(number)) for number in range(14))
    assert 2 * 3 ** len(zones) > MOST_CELLS
    rendering = replace(rig.rendering, device=replace(DEVICE, zones=zones))
    assert with_fast_table(rendering, rig.session.link.capabilities).fast_table is None
