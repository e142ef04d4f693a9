"""The simulated rig: plays recorded touches through the engine and the wire to the emulated firmware. SIMULATED."""

import itertools
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import NamedTuple

from engine.effects.rules import DEFAULT_EFFECTS, Effects
from engine.loop.beside import ClickSolving
from engine.loop.dispatcher import Reopening
from engine.loop.loop import Clock, SystemClock
from engine.loop.observer import CommandRecord, Fate, LatencyRecorder, LoopCounters, Observers, Trace
from engine.table import Table
from engine.touch import Placement, Touch
from engine.touch.sources import Source
from engine.touch.sources.recording import Playback, Recording
from firmware_link.emulator.drive_log import Cause, DriveEvent, Outcome, ReceivedFrame
from firmware_link.emulator.emulator_process import EmulatorLog, run_emulator
from firmware_link.host.serial_port import ReopeningPort, SerialPort
from firmware_link.host.session import Port
from tactable.rig.emulate import configuration_of
from tactable.run.click_process import ClickProcess
from tactable.run.live_run import Live, LiveOptions

PTY_BIT_RATE_HZ = 2_000_000  # as tactable/bench/latency/conditions.py
_SEQUENCES = 256
_SET, _PLAY = "SET", "PLAY"


class Moment(NamedTuple):
    """The fingers from a time on, and what is wanted then; `level_db` None: no finger is to feel."""

    time_ns: int
    touches: tuple[Touch, ...]
    placement: Placement | None
    level_db: float | None


class _Moments(list[Moment]):
    """Observes where the fingers are at each frame and each change; its moments are in the order of their times."""

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:  # noqa: ARG002  # an Observer
        """Keep a frame or a change."""
        if record.frame is not None or record.fate is not Fate.NONE:
            self.append(Moment(record.time_ns, tuple(record.touches), record.placement, record.level_db))


@dataclass(frozen=True)
class LiveRun:
    """Record of one run: the loop's trace and counters, where the fingers were, and the log of the firmware."""

    trace: tuple[CommandRecord, ...]
    moments: tuple["Moment", ...]  # every touch frame and every change, in the order of their times
    counters: LoopCounters
    frames_sent: int  # SET and PLAY frames, renewals of the lease included
    latency: LatencyRecorder
    log: EmulatorLog

    def applied(self, change: CommandRecord) -> DriveEvent | None:
        """What the firmware drove once it had taken the command of a state change; None if it never took it.

        A command that came late is refused as stale; its renewals bring the same drive as long as the state lasts.
        """
        frame = next((f for f in self._frames(change) if f.outcome is Outcome.ACCEPTED), None)
        if frame is None:
            return None
        # A renewed drive causes no event, and several frames of one read have the same time.
        before = [event for event in self.log.events if _is_before(event, frame)]
        return before[-1] if before and before[-1].cause in (Cause.SET, Cause.PLAY) else None

    def came_late(self, change: CommandRecord) -> bool:
        """Whether the firmware refused the command and all its renewals, as it does when the machine has stalled."""
        frames = self._frames(change)
        return bool(frames) and all(frame.outcome is not Outcome.ACCEPTED for frame in frames)

    def _frames(self, change: CommandRecord) -> list[ReceivedFrame]:
        """The command of a state change and its renewals, as the firmware received them; a terminal loses none.

        A click has none: what follows it is silence.
        """
        since_us = (change.time_ns - self.log.host_ns_at_device_zero) / 1e3
        # Sequence numbers repeat after this many frames.
        frames = [frame for frame in self.log.received if frame.device_time_us >= since_us][:_SEQUENCES]
        sequences = [frame.sequence for frame in frames]
        if change.drive_sequence not in sequences:
            return []
        command, *later = frames[sequences.index(change.drive_sequence) :]
        if command.message == _PLAY:
            return [command]
        following = (c.drive_sequence for c in self.trace[self.trace.index(change) + 1 :])
        next_sequence = next((sequence for sequence in following if sequence is not None), None)
        renewals = itertools.takewhile(lambda frame: frame.sequence != next_sequence, later)
        return [command, *(frame for frame in renewals if frame.message == _SET)]


def play(table: Table, recording: Recording, speed: float, effects: Effects = DEFAULT_EFFECTS) -> LiveRun:
    """Replay touches at `speed` times real pace through the engine to an emulated firmware behind a pseudo-terminal.

    Raises what the engine raises: DigitizerError, DescriptorError, LinkError, LimitError, RendererError.
    """
    with ExitStack() as stack:
        emulator = stack.enter_context(run_emulator(configuration_of(table.device)))
        port = SerialPort(emulator.port)
        # After a stall of a second the port is opened again.
        reopening = ReopeningPort(lambda: SerialPort(emulator.port), port)
        stack.callback(reopening.close)
        solving = stack.enter_context(ClickProcess(table.path)) if table.clicks and effects.have_clicks else None
        if solving is not None:
            solving.wait_until_ready()
        clock = SystemClock()
        return play_to(port, clock, table, Playback(recording, speed), effects, emulator.stop, reopening, solving)


def play_to(
    port: Port,
    clock: Clock,
    table: Table,
    source: Source,
    effects: Effects,
    end: Callable[[], EmulatorLog],
    reopening: Reopening | None = None,
    solving: ClickSolving | None = None,
) -> LiveRun:
    """Play a source to an emulated firmware behind a port, on a clock; `end` gives its log."""
    # When the machine stalls for 250 ms, the firmware latches silence, as it must; the run greets it again and goes on.
    options = LiveOptions(effects, reconnect=True, bit_rate_hz=PTY_BIT_RATE_HZ)
    trace, moments = Trace(), _Moments()
    live = Live(table, source, port, clock, options, Observers(trace, moments), reopening, solving=solving)
    live.run()
    # A command that waited for the line is recorded twice, the second time after later frames.
    by_time = tuple(sorted(moments, key=lambda moment: moment.time_ns))
    return LiveRun(tuple(trace), by_time, replace(live.loop.counters), live.frames_sent, live.timing.latency, end())


def _is_before(event: DriveEvent, frame: ReceivedFrame) -> bool:
    """Whether an event happened by the time a frame had been taken."""
    if event.device_time_us != frame.device_time_us or event.sequence is None:
        return event.device_time_us <= frame.device_time_us
    return (frame.sequence - event.sequence) % _SEQUENCES < _SEQUENCES // 2


class Wanted(NamedTuple):
    """The drive or click that a state change asks for."""

    placement: Placement
    level_db: float
    is_click: bool  # a click that nobody solves is answered by a steady drive; then this is False


def wanted_of(change: CommandRecord) -> Wanted | None:
    """The wanted drive or click of a change; None where no finger is to feel."""
    if change.level_db is None or change.placement is None:
        return None
    return Wanted(change.placement, change.level_db, change.is_click and not change.drive)


def first_applied(run: LiveRun) -> dict[Wanted, DriveEvent]:
    """The first drive event of each drive or click that reached the firmware."""
    found: dict[Wanted, DriveEvent] = {}
    for change in run.trace:
        wanted, event = wanted_of(change), run.applied(change)
        if wanted is not None and event is not None:
            found.setdefault(wanted, event)
    return found
