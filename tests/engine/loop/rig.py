"""The loop on a virtual line to an emulated device."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from engine.device import Device
from engine.effects.effect_player import DEFAULT_CLICK_NS
from engine.effects.rules import Drives, Effect, Effects, Rule, Segment, Trigger, burst
from engine.loop.beside import ClickSolving, ControlSlot, Updates
from engine.loop.dispatcher import Dispatcher
from engine.loop.fast.fast_layout import NONE, FastRendering, with_fast_table
from engine.loop.fast.fast_path import FastPath
from engine.loop.fast.moment import FastLink, FastSession
from engine.loop.loop import Clock, Loop, Measuring, connect
from engine.loop.observer import CommandRecord, Fate, LoopCounters, Observer, Observers, Timing, Trace
from engine.loop.pipeline import open_pipeline
from engine.loop.ring import Record, RingWriter
from engine.render.board_fit import BoardFit, choose_basis
from engine.render.limits import link_configuration
from engine.render.prepared import Rendering
from engine.render.renderer import RenderedClicks, Renderer, Steady, ZoneDrives
from engine.table import Clicks
from engine.table.best_rows import BestRows
from engine.touch.sources import Source
from engine.touch.sources.recording import Playback, Recording, Report
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.host.link_values import Capabilities
from firmware_link.host.serial_port import ReopeningPort
from tests.engine.made_table import LEVEL_DB, made_clicks, state_index, states_of
from tests.engine.render.made_steady import MadeSteady
from tests.engine.touch.descriptors import BLOB, CONTACT_COUNT, application, finger
from tests.precompute.devices import shipped
from tests.tools.virtual import VirtualLine

_HEAD = struct.Struct("<qq")
DEVICE = shipped("reference-a")
NO_CLICKS = made_clicks(DEVICE, ())
SLOTS = 4
DESCRIPTOR = application(*(finger(flags="0942 0932 0947") for _ in range(SLOTS)), CONTACT_COUNT, BLOB)
BIT_RATE_HZ = 1_000_000
CLICK_AHEAD_NS = 28_000_000  # as of reference-a
Touch = tuple[int, complex]
"""Contact id and place, as fractions of the sides of the touch area; a real one lies in its middle across."""
BURSTS = Effects((Rule(Trigger.TOUCH, burst(LEVEL_DB, 50)),))
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),))


class Packets(Playback):
    """A playback whose reports the compiled step may read, each behind its time."""

    packet_head = _HEAD.size

    def packet_fileno(self) -> int:
        return -1

    def next_packet(self, now_ns: int) -> bytes:
        report = super().read(now_ns)
        return b"" if report is None else _HEAD.pack(self.report_time_ns, 0) + report

    def has_packet(self, now_ns: int) -> bool:
        due_ns = self.next_time_ns()
        return due_ns is not None and due_ns <= now_ns

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:
        assert is_last is False or not self.has_packet(now_ns)
        return packet[_HEAD.size :]


class VirtualFastPath(FastPath):
    """Waits as the line does, and writes to it."""

    _clock: VirtualLine
    _packets: Packets

    def _run(self, until_ns: int) -> None:
        fast, line = self._moment.fast, self._clock
        fast.packet_size = fast.frame_size = fast.written = 0
        line.wait(None if until_ns == NONE else until_ns, (-1,) if line.is_open else (), ())
        now_ns = fast.read_ns = fast.written_ns = line.now_ns()
        fast.readable[:] = (1,) * len(fast.readable)
        packet = self._packets.next_packet(now_ns)
        fast.packet_size = len(packet)
        fast.packet[: len(packet)] = packet
        self._library.fast_set_time(now_ns)
        if packet and fast.can_answer and self._library.fast_answer(self._moment.address):
            if self._packets.has_packet(now_ns):
                fast.frame_size = 0
            else:
                fast.written = line.write(bytes(fast.frame[: fast.frame_size]))
        self._library.fast_set_time(NONE)


def index_of(*zones: int, quiet: Sequence[int] = ()) -> int:
    """State of the zones (`state_index`) with fingers that feel, or are quiet, in their middles."""
    return state_index(states_of(DEVICE, zones, quiet))


def report(*touches: Touch, lifted: Sequence[int] = (), palms: Collection[int] = ()) -> bytes:
    """One frame of up to four contacts in one report: those that touch, some as palms, and those that lift."""
    slots = [
        struct.pack("<BBHH", 3 if contact_id in palms else 7, contact_id, round(1000 * place.real), across_of(place))
        for contact_id, place in touches
    ]
    slots += [struct.pack("<BBHH", 4, contact_id, 0, 500) for contact_id in lifted]
    return b"\x01" + b"".join(slots[:SLOTS]).ljust(6 * SLOTS, b"\0") + bytes([min(len(slots), SLOTS)])


def across_of(place: complex) -> int:
    return round(1000 * place.imag) if isinstance(place, complex) else 500


def recording_of(*frames: tuple[float, bytes]) -> Recording:
    """Reports with their times in seconds."""
    reports = tuple(Report(index, time_s, data) for index, (time_s, data) in enumerate(frames))
    return Recording("virtual digitizer", 3, 0, 0, DESCRIPTOR, reports)


def held(start_s: float, stop_s: float, *touches: Touch) -> list[tuple[float, bytes]]:
    """A frame each 8 ms while fingers rest."""
    return [(start_s + 0.008 * i, report(*touches)) for i in range(round((stop_s - start_s) / 0.008))]


def rendering_of(
    capabilities: Capabilities,
    effects: Effects,
    clicks: Clicks = NO_CLICKS,
    device: Device = DEVICE,
    always_hz: float | None = None,
    *,
    steady: Steady | None = None,
    refuses: bool = False,
    bit_rate_hz: int = BIT_RATE_HZ,
) -> FastRendering:
    """A table for the run of a rig; its steady drives are those of `MadeSteady` where no others are given."""
    configuration = link_configuration(device, bit_rate_hz)
    held = clicks.basis if effects.drives is Drives.POSITIONS else None
    basis = choose_basis(held, capabilities, bit_rate_hz, configuration.lease_ms)
    steady, rendered = steady or MadeSteady(device, always_hz=always_hz), RenderedClicks(clicks, basis, refuses)
    renderer = Renderer(capabilities, steady, rendered, effects.levels_db)
    configuration = replace(configuration, basis=basis.basis)
    ahead_ns = 0 if basis.basis is None else CLICK_AHEAD_NS
    made = Rendering(device, renderer, configuration, DEFAULT_CLICK_NS, ahead_ns, BoardFit((1.0, 1.0)))
    return with_fast_table(made, capabilities)


@dataclass
class Watch:
    """Looks at each wake-up of a loop, and may ask it to stop."""

    is_set: Callable[[], bool]


@dataclass
class Rig:
    """A run over a virtual line."""

    recording: Recording
    line: VirtualLine = field(default_factory=VirtualLine)
    speed: float | None = 1.0
    reconnect: bool = False
    reopening: ReopeningPort[VirtualLine] | None = None
    bit_rate_hz: int = BIT_RATE_HZ
    effects: Effects = HELD
    ring: RingWriter | None = None
    device: Device = DEVICE
    clicks: Clicks = NO_CLICKS
    rows: BestRows | None = None
    """Drives of zones are played, of these rows."""
    refuses: bool = False
    solving: ClickSolving | None = None
    control: ControlSlot | None = None
    updates: Updates | None = None
    measuring: Measuring | None = None
    library: ClassVar[ctypes.CDLL | None] = None
    """Of the fast path: the loop's tests hold with it and without."""

    def __post_init__(self) -> None:
        self.trace, timing = Trace(), Timing()
        self.latency = timing.latency
        device, refuses, line = self.device, self.refuses, self.line
        session = FastSession(FastLink(link_configuration(device, self.bit_rate_hz)), line, line.now_ns)
        capabilities = connect(session, line)
        self.steady = MadeSteady(device, refuses=refuses)
        zones = None if self.rows is None else ZoneDrives(device, capabilities, self.rows, refuses, (1.0, 1.0))
        more: dict[str, Any] = {"steady": zones or self.steady, "refuses": refuses, "bit_rate_hz": self.bit_rate_hz}
        self.rendering = rendering_of(capabilities, self.effects, self.clicks, device, **more)
        self.renderer = self.rendering.renderer
        if self.rendering.basis is not None:
            session = FastSession(FastLink(self.rendering.configuration), line, line.now_ns)
            connect(session, line)
        self.session, self.start_ns = session, line.time_ns
        source = Packets(self.recording, self.speed)
        pipeline = open_pipeline(source, device, self.effects, self.renderer, line.now_ns)
        pipeline.player.ahead_ns = self.rendering.click_ahead_ns
        dispatcher = Dispatcher(session, self.line.now_ns)
        self.observers = Observers(self.trace, timing, self.ring)
        edges: tuple[Source, Clock, Observer] = (source, self.line, self.observers)
        if self.library is not None:
            fast = VirtualFastPath(
                self.library, source, pipeline, dispatcher, self.line, self.effects, self.rendering, self.observers
            )
            edges = (fast.source, fast, fast)
        self.loop = Loop(
            pipeline,
            dispatcher,
            *edges,
            reconnect=self.reconnect,
            reopening=self.reopening,
            solving=self.solving,
            control=self.control,
            updates=self.updates,
            measuring=self.measuring,
        )

    def run(self) -> Rig:
        self.loop.run()
        assert self.session.fast_counters.mispredicted == 0
        return self

    @property
    def log(self) -> list[DriveEvent]:
        return self.line.log

    def states(self) -> list[int]:
        """State of the zones at each change of what is wanted, as `index_of` numbers it; 0: no finger feels."""
        placements = (change.placement for change in self.trace)
        return [0 if placement is None else state_index(placement.zone_states(self.device)) for placement in placements]

    def played(self) -> list[float]:
        """Frequency of the first actuator at each change of the drive, 0 for silence."""
        return [round(event.channels[0].frequency_hz * bool(event.channels[0].amplitude), 2) for event in self.log]


def observe(writer: RingWriter, record: Record) -> None:
    """As a loop does."""
    values = record._asdict() | {"frame": None, "fate": Fate.NONE}
    record_values = {name: values[name] for name in CommandRecord._fields}
    writer.observe(CommandRecord(**record_values), LoopCounters(**record.counters._asdict()))
