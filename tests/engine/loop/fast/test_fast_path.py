"""The fast path around the compiled step: real packets, recordings of panels, and an answer that is wrong.

The compiled step's clicks: what is in the arrays, left out, and how small.
"""

import contextlib
import ctypes
import pickle
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from engine.effects.rules import DEFAULT_EFFECTS, Effects, Rule, Trigger, click
from engine.loop.dispatcher import Dispatcher
from engine.loop.fast.fast_layout import NONE, FastTable, with_fast_table
from engine.loop.fast.fast_path import FastPath
from engine.loop.fast.moment import FastSession
from engine.loop.loop import Clock, SystemClock
from engine.loop.pipeline import open_pipeline
from engine.render.renderer import PlayCommand
from engine.touch.placement import Places
from engine.touch.sources.recording import read_recording
from firmware_link.emulator.drive_log import Cause
from firmware_link.host.serial_port import DescriptorPort
from firmware_link.protocol.basis import Basis, BasisSet
from firmware_link.protocol.messages import encode_play
from tests.engine.loop.fast.scripts import LOUD_DB, varied_clicks
from tests.engine.loop.rig import DESCRIPTOR, DEVICE, Packets, Rig, held, recording_of, report
from tests.engine.made_table import LEVEL_DB, click_of, every_click, made_clicks, places_of
from tests.engine.shared_recordings import recording_params
from tests.engine.touch.descriptors import BLOB, CONTACT_COUNT, application, finger
from tests.tools.guard import allowed
from tests.tools.virtual import MS, VirtualClock

CLICKS = every_click(DEVICE)
LEVELS_DB = (LEVEL_DB, LOUD_DB, float("inf"))
IDLE = recording_of((0.0, report()))
pytestmark = pytest.mark.usefixtures("fast_library")


class FastRig(Rig):
    """With the fast path."""


@pytest.mark.parametrize("path", recording_params("touch", "*.hid", long_but=8))
def test_a_recorded_device_is_answered_as_the_loop_does(fast_library: ctypes.CDLL, path: Path) -> None:
    recording = read_recording(path)
    FastRig.library = fast_library
    short = replace(recording, reports=recording.reports[:400])
    slow, fast = (rig(short, speed=8.0, effects=DEFAULT_EFFECTS, clicks=CLICKS).run() for rig in (Rig, FastRig))
    assert fast.trace == slow.trace
    assert fast.log == slow.log


def test_a_surface_that_the_digitizer_turns_to_is_answered_as_if_it_were_alone(fast_library: ctypes.CDLL) -> None:
    FastRig.library = fast_library
    pad = application(
        *[finger(flags="0942 0932 0947").replace(b"\x26\xe8\x03", b"\x26\xd0\x07")] * 4,
        CONTACT_COUNT,
        BLOB,
        report_id=7,
    )
    touches = [(0.2 * index, report(*[(1, 0.3 + 0.2 * index)] * (index % 2))) for index in range(8)]
    alone = recording_of(*((time_s, b"\x07" + data[1:]) for time_s, data in touches))
    rigs = [
        rig(replace(alone, descriptor=descriptor), effects=DEFAULT_EFFECTS, clicks=CLICKS).run()
        for rig, descriptor in ((Rig, pad), (FastRig, DESCRIPTOR + pad))
    ]
    assert rigs[0].log == rigs[1].log and rigs[0].trace == rigs[1].trace
    assert rigs[1].session.fast_counters.answered


class Sockets(Packets):
    """Packets of a real socket."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(recording_of((0.0, report())))
        self._descriptor = descriptor

    def packet_fileno(self) -> int:
        return self._descriptor

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:  # noqa: ARG002  # a PacketSource
        (self.report_time_ns,) = struct.unpack_from("<q", packet)
        return packet[self.packet_head :]


class Ends(NamedTuple):
    """A fast path on sockets, and their ends: ours and its own for touches, ours and its own for the device."""

    fast: FastPath
    session: FastSession
    ours: socket.socket
    touch: socket.socket
    device: socket.socket
    port: socket.socket


@contextlib.contextmanager
def on_sockets(library: ctypes.CDLL, clock: Clock | None = None) -> Iterator[Ends]:
    """A fast path that waits on the system, without a loop; its time stands still without a clock."""
    rig = Rig(recording_of((0.0, report())), effects=DEFAULT_EFFECTS, clicks=CLICKS)
    if clock is None:
        clock = VirtualClock(rig.line.time_ns + 50 * MS)  # the handshake has left the line
        library.fast_set_time(clock.now_ns())
    with contextlib.ExitStack() as stack:
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
        (ours, touch), (device, port) = [[stack.enter_context(end) for end in pair] for pair in pairs]
        stack.callback(library.fast_set_time, NONE)
        source, session = Sockets(touch.fileno()), rig.session
        session.port = DescriptorPort("the socket", port.fileno())
        pipeline = open_pipeline(source, DEVICE, DEFAULT_EFFECTS, rig.renderer)
        dispatcher = Dispatcher(session, clock.now_ns)
        fast = FastPath(library, source, pipeline, dispatcher, clock, DEFAULT_EFFECTS, rig.rendering)
        yield Ends(fast, session, ours, touch, device, port)


@pytest.mark.machine
def test_a_wait_without_a_report_ends_at_its_time_and_not_before(fast_library: ctypes.CDLL) -> None:
    with on_sockets(fast_library, SystemClock()) as (fast, session, _, touch, _, port):
        for after_ns in (-(10**18), 0, 20_000_000, 20_000_000):  # the timer is set again
            until_ns = max(0, fast.now_ns() + after_ns)
            readable = fast.wait(until_ns, (touch.fileno(), port.fileno()), ())
            assert fast.now_ns() >= until_ns
            assert readable == [] and session.answer is None


@pytest.mark.parametrize("waiting", [1, 2])
def test_a_report_that_is_not_the_last_is_left_to_the_loop(fast_library: ctypes.CDLL, waiting: int) -> None:
    with on_sockets(fast_library) as (fast, session, ours, touch, device, port):
        source = fast.source
        for place in (0.1, 0.5)[:waiting]:
            ours.send(struct.pack("<qq", fast.now_ns(), 0) + report((1, place)))
        readable = fast.wait(None, (touch.fileno(), port.fileno()), ())
        device.setblocking(False)
        assert readable is not None and touch.fileno() in readable and port.fileno() not in readable
        assert source.taken is not None
        assert source.taken.read_ns == fast.now_ns()
        if waiting == 1:
            assert session.answer is not None
            assert session.answer.frame == device.recv(4096)
            assert session.answer.written == len(session.answer.frame)
            return
        assert session.answer is None
        with pytest.raises(BlockingIOError):
            device.recv(4096)


def test_its_times_are_of_the_clock_that_the_loop_reads(fast_library: ctypes.CDLL) -> None:
    with allowed("compares two readings of one clock"), on_sockets(fast_library) as (fast, _, ours, touch, _, port):
        fast_library.fast_set_time(NONE)
        ours.send(struct.pack("<qq", 0, 0) + report((1, 0.1)))
        before_ns = time.monotonic_ns()
        fast.wait(None, (touch.fileno(), port.fileno()), ())
        assert fast.source.taken is not None and before_ns <= fast.source.taken.read_ns <= time.monotonic_ns()


def test_time_stands_at_a_report_until_its_answer_is_confirmed(fast_library: ctypes.CDLL) -> None:
    with on_sockets(fast_library) as (fast, session, ours, touch, _, port):
        source, due_ns = fast.source, fast.now_ns() - 5_000_000
        ours.send(struct.pack("<qq", due_ns, 0) + report((1, 0.1)))
        fast.wait(None, (touch.fileno(), port.fileno()), ())
        assert session.answer is not None and source.read(fast.now_ns()) == report((1, 0.1))
        # What fell due between the report and its reading waits, since the step did not know of it.
        assert source.source_time_ns(fast.now_ns()) == due_ns < session.answer.read_ns
        session.answer = None
        assert source.source_time_ns(fast.now_ns()) > due_ns


def test_a_wrong_answer_is_put_right_and_the_last(fast_library: ctypes.CDLL) -> None:
    FastRig.library = fast_library
    frames = [*held(0.0, 0.1, (1, 0.1)), (0.5, report(lifted=[1])), (1.0, report((1, 0.5))), (1.1, report(lifted=[1]))]
    frames += [(2.0, report((1, 0.9))), (2.1, report(lifted=[1]))]
    rig = FastRig(recording_of(*frames), effects=DEFAULT_EFFECTS, clicks=CLICKS, reconnect=True)
    assert rig.rendering.fast_table is not None
    rig.rendering.fast_table.amplitude[:] //= 2
    rig.loop.run()
    counters = rig.session.fast_counters
    assert (counters.mispredicted, counters.answered) == (1, 0)
    amplitudes = [event.waveform.amplitude for event in rig.log if event.cause is Cause.PLAY and event.waveform]
    # The first touch finds the line busy, the second answer is wrong, and the loop gives the third by itself.
    assert amplitudes[0] == amplitudes[2] == pytest.approx(2 * amplitudes[1], abs=1e-4)


EFFECTS = Effects(tuple(Rule(Trigger.TOUCH, click(level_db)) for level_db in LEVELS_DB))


def table_of(rig: Rig) -> FastTable:
    assert rig.rendering.fast_table is not None
    return rig.rendering.fast_table


@pytest.mark.parametrize("refuses", [False, True])
def test_every_click_of_every_level_is_the_one_that_the_renderer_gives(refuses: bool) -> None:
    clicks = varied_clicks(DEVICE)
    rig = Rig(IDLE, effects=EFFECTS, clicks=clicks, refuses=refuses)
    table, refused = table_of(rig), 0
    for level, level_db in enumerate(table.levels_db):
        for row in range(len(clicks)):
            command = rig.renderer.render(clicks[row].placement, level_db, is_click=True)
            basis_set, fraction_bits, count = table.head[row].tolist()
            amplitude = int(table.amplitude[level, row])
            if isinstance(command, PlayCommand):
                weights = table.weights[row, :count].tolist()
                assert encode_play(basis_set, fraction_bits, amplitude, weights) == command.click.play
            else:
                refused += 1
                assert amplitude == NONE
    assert (refused > 0) == refuses


def test_a_set_that_the_device_does_not_hold_is_not_played() -> None:
    clicks = varied_clicks(DEVICE)
    rig = Rig(IDLE, effects=EFFECTS, clicks=clicks)
    rig.renderer.clicks.basis = replace(rig.renderer.clicks.basis, sets={1: 0})
    assert rig.session.link.capabilities is not None
    table = with_fast_table(rig.rendering, rig.session.link.capabilities).fast_table
    assert table is not None
    assert ((table.amplitude == NONE) == (clicks.basis_set == 0)).all()
    assert (table.head[clicks.basis_set == 1, 0] == 0).all()


def test_more_places_or_zones_than_there_is_room_for_take_the_long_way() -> None:
    rig = Rig(IDLE, effects=EFFECTS, clicks=every_click(DEVICE))
    assert rig.session.link.capabilities is not None
    zones = tuple(replace(DEVICE.zones[0], name=str(number)) for number in range(17))
    rendering = replace(rig.rendering, device=replace(DEVICE, zones=zones))
    assert with_fast_table(rendering, rig.session.link.capabilities).fast_table is None
    other = replace(every_click(DEVICE), places=Places(DEVICE.bar.length_m, 1100))
    assert Rig(IDLE, effects=EFFECTS, clicks=other).rendering.fast_table is None


def test_a_click_too_long_for_a_frame_of_one_block_is_left_to_the_loop() -> None:
    placement = places_of(DEVICE).placement((5,))
    few = click_of(DEVICE, placement)
    many = replace(few, weights=np.ones(121, np.int16), basis=_wide_basis(few.basis.sample_rate_hz))
    table = table_of(Rig(IDLE, effects=EFFECTS, clicks=made_clicks(DEVICE, [many])))
    assert (table.amplitude == NONE).all()


def _wide_basis(sample_rate_hz: int) -> Basis:
    return Basis(sample_rate_hz, (BasisSet(np.zeros((121, 11), np.int16), np.arange(121, dtype=np.uint8) % 2),))


def test_what_the_renderer_holds_already_travels_once() -> None:
    rendering = Rig(IDLE, effects=EFFECTS, clicks=varied_clicks(DEVICE)).rendering
    alone = replace(rendering, fast_table=None)
    table, received = rendering.fast_table, pickle.loads(pickle.dumps(rendering))
    assert table is not None
    more = len(pickle.dumps(rendering)) - len(pickle.dumps(alone))
    assert more < table.amplitude.nbytes + table.head.nbytes + 1000
    assert received.fast_table.pair is received.renderer.clicks.clicks.pair
