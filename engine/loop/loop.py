"""Reports to commands: one thread that waits once for touches, the link and time."""

import math
import select
import time
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from engine.effects import EffectPlayer
from engine.loop.fast.step import Answer, FastPath
from engine.loop.fast.table import FastTable
from engine.loop.latency import LatencyRecorder, Stamps
from engine.loop.ring import RingWriter
from engine.render.prepared import Rendering
from engine.render.renderer import SILENCE, DriveCommand, Renderer
from engine.touch import Digitizer, FingerTracker, Touch, TouchFrame
from engine.touch.digitizer import RELEASE_AFTER_NS
from engine.touch.scan_time import ScanTimes
from engine.touch.sources import Source
from firmware_link.host.link_values import (
    Armed,
    BankRefused,
    BankReplaced,
    Capabilities,
    Event,
    FaultReceived,
    Greeted,
    LinkState,
)
from firmware_link.host.session import Port, Session
from firmware_link.protocol.errors import LinkError, LinkLostError

NS_PER_S = 1_000_000_000
# The ring of hidraw holds 63 reports: after a stall all are taken before anything is sent, and the link never waits
# for more.
REPORTS_PER_PASS = 64
# A line that takes nothing is looked after this often, so that the patience of the link still ends.
BLOCKED_LINE_NS = 5_000_000
_ENDED = (LinkState.STOPPED, LinkState.DISCONNECTED)
# Without a port nothing else wakes the loop up for a request to stop.
LOST_PORT_NS = 80_000_000


class Clock(Protocol):
    """Time, and waiting for it: the system's, or a test's own."""

    def now_ns(self) -> int:
        """Monotonic; the session must be given the same."""

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int] | None:
        """Return when a descriptor can be read or written, or at `until_ns`; earlier does no harm.

        Those that can be read; None where that is not known.
        """


class SystemClock:
    """The monotonic clock; waits in the system."""

    now_ns = staticmethod(time.monotonic_ns)
    """Monotonic time; the function itself, for it is called several times between a touch and its command."""

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int]:
        """Wait with `select`, which counts in us: `poll` rounds up to whole ms, half a ms late for a playback."""
        timeout_s = None if until_ns is None else max(0, until_ns - time.monotonic_ns()) / NS_PER_S
        return select.select(readable, writable, (), timeout_s)[0]


class StopRequest(Protocol):
    """What ends a run; `threading.Event` has it. The loop looks at each wake-up, at most 80 ms apart."""

    def is_set(self) -> bool:
        """Whether to end."""


class Reopening(Protocol):
    """What finds a lost port again: `ReopeningPort` has it."""

    def lose(self, now_ns: int) -> None:
        """The port is gone: give it back."""

    def poll(self, now_ns: int) -> Port | None:
        """The port, opened now if it is time to try; None while it is gone."""

    def next_attempt_ns(self) -> int | None:
        """When `poll` tries next; None while the port is open."""


class Updates(Protocol):
    """Where new tables come from while a loop runs, verified and rendered by somebody else."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def poll(self) -> Rendering | None:
        """The newest, once it is here whole; never waits."""


class StateChange(NamedTuple):
    """One line of the trace: the zones took a new state or level, and what was sent for it."""

    time_ns: int
    """Clock time at which the state was known."""
    report_index: int | None
    """The report that completed the frame; None for what time alone brought, and at the end of the run."""
    state: int
    level_db: float | None
    """Wanted sensation level; None: no zone is felt."""
    is_click: bool
    """A click was wanted, not a steady drive."""
    drive_sequence: int | None
    """Sequence of the SET or PLAY.

    None where the drive stayed the same, a newer one replaced it unsent, or the link was not ready.
    """
    finger_positions_m: tuple[float, ...]


@dataclass
class LoopCounters:
    """What the loop did. A command is a drive or a click that was sent; renewals do not count.

    Each loss of the port or of the device behind it is counted, and each new session after that or after a stop.
    """

    reports: int = 0
    frames: int = 0
    state_changes: int = 0
    commands: int = 0
    losses: int = 0
    reconnects: int = 0
    swaps: int = 0
    """Changes over to another table."""
    answered: int = 0
    """Commands that the fast path wrote before the loop knew of them."""
    mispredicted: int = 0
    """Those that were not the loop's: the run went on without the fast path, in a new session."""


class _Pending(NamedTuple):
    """A state change until its command is written."""

    time_ns: int
    report_index: int | None
    state: int
    level_db: float | None
    is_click: bool
    touches: Sequence[Touch]
    sent_before: int
    stamps: tuple[int, int, int, int, int] | None
    """Up to COMMAND, where a report caused it."""

    def change(self, sequence: int | None) -> StateChange:
        """Its line of the trace."""
        positions_m = tuple(touch.position_m for touch in self.touches)
        return StateChange(*self[:5], sequence, positions_m)


class _News(NamedTuple):
    """A report and what is wanted since, or a change that time brought, until there is time to tell."""

    time_ns: int
    report_index: int | None
    state: int
    level_db: float | None
    is_click: bool
    touches: Sequence[Touch]
    report: bytes


class _Sent(NamedTuple):
    """The command that left in a pass."""

    report_index: int | None
    time_ns: int
    stamps: Stamps | None
    sequence: int | None


def connect(session: Session, clock: Clock) -> Capabilities:
    """Greet, compare clocks and arm: what the renderer needs to know of the device.

    The device disarms when the loop does not run within 250 ms. Raises LinkError when there is no fitting device.
    """
    session.connect()
    while session.link.state is not LinkState.READY:
        _wait_for_link(session, clock)
        session.exchange()
    assert session.link.capabilities is not None  # a link that is READY was greeted
    return session.link.capabilities


class Loop:
    """Runs touches of one source to one link that `connect` made ready; clock, source and session are the caller's.

    `trace` gets a line for each state change, in order. `latency` gets the stamps of each command that a report caused,
    `scan_times` those of each frame of a digitizer that has a clock.
    With `reconnect` a device that stopped itself is greeted and armed again, and the state of the moment sent anew;
    without, that is a LinkError. With `reopening` so is one whose port was lost or that does not answer, once its port
    is back; touches are read all the while. `ring` gets a record for each report, and for each change that time
    brought, once the command of the pass is written. With `updates` it changes over to each table that comes;
    `bank_data` are the bytes of the bank that the link is configured with. `fast` waits in place of the clock, and
    answers what it can from `fast_table`.
    """

    def __init__(
        self,
        source: Source,
        digitizer: Digitizer,
        tracker: FingerTracker,
        player: EffectPlayer,
        renderer: Renderer,
        session: Session,
        clock: Clock,
        *,
        reconnect: bool = False,
        reopening: Reopening | None = None,
        trace: list[StateChange] | None = None,
        latency: LatencyRecorder | None = None,
        scan_times: ScanTimes | None = None,
        ring: RingWriter | None = None,
        updates: Updates | None = None,
        bank_data: bytes = b"",
        fast: FastPath | None = None,
        fast_table: FastTable | None = None,
    ) -> None:
        self.counters = LoopCounters()
        self._source = source
        self._digitizer = digitizer
        self._tracker = tracker
        self._player = player
        self._renderer = renderer
        self._session = session
        self._link = session.link
        self._clock = clock
        self._now_ns = clock.now_ns
        self._reconnect = reconnect
        self._reopening = reopening
        self._trace = trace
        self._latency = latency
        self._scan_times = scan_times
        self._ring = ring
        self._updates = updates
        self._bank_data = bank_data
        self._fast = fast
        self._answer: Answer | None = None  # what the fast path took during the wait
        if fast is not None:
            fast.refit(tracker, fast_table)
        self._next: Rendering | None = None  # what to change over to
        self._is_handed_over = self._needs_session = False
        self._news: list[_News] = []
        self._sent: _Sent | None = None
        self._read_ns = 0
        self._state = 0
        self._level_db: float | None = None
        self._click_ns: int | None = None
        self._held = SILENCE  # what the device drives unless a waveform plays
        self._touches: Sequence[Touch] = ()
        self._release_ns: int | None = None  # when the watchdog acts, on the source's axis; None with no contact
        self._due_ns: float = math.inf  # when time alone brings something, on the source's axis
        self._pending: _Pending | None = None
        self._watch((session.port.fileno(),))

    def run(self, stop: StopRequest | None = None) -> None:
        """Until source, contacts and effects have ended, or `stop` is set; then silence and a STOP.

        Raises LinkError when the port or the device fails; counters and trace are final then too.
        """
        try:
            while not self._is_over(stop):
                readable = self._wait()
                self._read_touches()
                self._keep_link(readable)
                if self._updates is not None:
                    self._look_for_update(self._updates, readable)
                if self._ring is not None:
                    self._tell(self._ring)
            self._silence()
            self._stop()
            if self._ring is not None:
                self._tell(self._ring)
        except LinkError:
            self._link.disconnect()
            raise
        finally:
            self._settle()

    def _is_over(self, stop: StopRequest | None) -> bool:
        if stop is not None and stop.is_set():
            return True
        return self._source.ended and self._release_ns is None and self._player.next_change_ns is None

    def _wait(self) -> Container[int] | None:
        source, session = self._source, self._session
        deadlines_ns = [_link_deadline_ns(session, self._clock), source.next_time_ns()]
        if not self._port and self._reopening is not None:
            deadlines_ns += [self._reopening.next_attempt_ns(), self._now_ns() + LOST_PORT_NS]
        due_ns = (self._release_ns, self._player.next_change_ns)
        deadlines_ns += [source.clock_time_ns(time_ns) for time_ns in due_ns if time_ns is not None]
        until_ns = min((deadline_ns for deadline_ns in deadlines_ns if deadline_ns is not None), default=None)
        if self._fast is not None and not source.ended and not session.wants_to_write():
            packets = self._fast.packet_fileno()
            if packets is not None:
                return self._wait_fast(self._fast, packets, until_ns)
        return self._clock.wait(
            until_ns,
            self._port if source.ended else self._port_and_touch,
            self._port if session.wants_to_write() else (),
        )

    def _wait_fast(self, fast: FastPath, packets: int, until_ns: int | None) -> Container[int]:
        """Wait, and let a report be answered before the loop takes it."""
        others = self._port if self._updates is None else (*self._port, self._updates.fileno())
        is_idle = self._port and self._pending is None
        readable, self._answer = fast.wait(
            until_ns,
            (packets, *others),
            self._link if is_idle else None,
            self._port[0] if self._port else -1,
            self._due_ns,
            (self._state, self._level_db, self._click_ns),
            self._held,
        )
        return readable

    def _read_touches(self) -> None:
        """Every report that is there, in order; time acts by itself only on a source that has no more."""
        source, now_ns = self._source, self._now_ns()
        if self._answer is not None and self._fast is not None:
            answer = self._answer
            self._take_report(self._fast.report_of(answer), answer)
            self._answer = None
            if answer.frame:
                return  # there was no other report
        for _ in range(REPORTS_PER_PASS):
            report = source.read(now_ns)
            if report is None:
                break
            self._take_report(report)
        else:
            return
        self._catch_up(source.source_time_ns(now_ns))

    def _take_report(self, report: bytes, answer: Answer | None = None) -> None:
        """With an `answer` the report was read during the wait, and perhaps its command written."""
        self._follow_report(report, answer)
        if answer is not None and answer.frame:
            self._confirm(answer)
        if self._ring is not None:
            self._note(self._read_ns, self._source.report_index, report)

    def _follow_report(self, report: bytes, answer: Answer | None) -> None:
        source, now_ns = self._source, self._now_ns
        read_ns, report_time_ns = now_ns() if answer is None else answer.read_ns, source.report_time_ns
        self._read_ns = read_ns
        self.counters.reports += 1
        # After a stall, or in a playback that does not wait, what was due before may be seen only now.
        if self._due_ns <= report_time_ns:
            self._catch_up(report_time_ns)
        frame = self._digitizer.decode_report(report, report_time_ns)
        if frame is None:
            return
        if self._scan_times is not None and frame.scan_time_ns is not None:
            self._scan_times.record(frame.time_ns, frame.scan_time_ns)
        written = answer if answer is not None and answer.frame else None
        frame_ns = now_ns() if written is None else written.frame_ns
        self.counters.frames += 1
        if self._take_frame(frame):
            available_ns = source.clock_time_ns(report_time_ns)
            state_ns = now_ns() if written is None else written.state_ns
            command_ns = None if written is None else written.command_ns
            self._command(source.report_index, state_ns, (available_ns, read_ns, frame_ns), command_ns)

    def _confirm(self, answer: Answer) -> None:
        """The command is out: what the link would send must be the same."""
        if self._session.confirm(answer.frame, answer.written, answer.asked_ns):
            self.counters.answered += 1
            if self._pending is not None and not self._session.wants_to_write() and self._is_sent():
                self._settle(answer.written_ns)
            return
        # A fault of the fast path: begin anew, without it.
        self.counters.mispredicted += 1
        self._fast = None
        self._session.connect()

    def _catch_up(self, source_time_ns: int) -> None:
        """What time alone brings, in order: changes of effects, and the release by the watchdog."""
        if self._due_ns > source_time_ns:
            return
        release_ns = self._release_ns
        if release_ns is not None and release_ns <= source_time_ns:
            self._advance_effects(release_ns)
            frame = self._digitizer.expire(release_ns)
            if frame is not None and self._take_frame(frame):
                self._command_by_time()
        self._advance_effects(source_time_ns)

    def _advance_effects(self, source_time_ns: int) -> None:
        player = self._player
        while player.next_change_ns is not None and player.next_change_ns <= source_time_ns:
            player.advance(player.next_change_ns)
            if self._take_state():
                self._command_by_time()

    def _command_by_time(self) -> None:
        now_ns = self._now_ns()
        self._command(None, now_ns, None)
        if self._ring is not None:
            self._note(now_ns, None, b"")

    def _take_frame(self, frame: TouchFrame) -> bool:
        """Whether the frame brings a new state."""
        time_ns = frame.time_ns
        self._release_ns = time_ns + RELEASE_AFTER_NS if frame.contacts else None
        touches = self._touches = self._tracker.track(frame)
        if self._player.take(touches, time_ns):
            return self._take_state()
        self._note_due()
        return False

    def _take_state(self) -> bool:
        player = self._player
        self._note_due()
        state, level_db, click_ns = player.state, player.level_db, player.click_ns
        if state == self._state and level_db == self._level_db and click_ns == self._click_ns:
            return False
        self._state, self._level_db, self._click_ns = state, level_db, click_ns
        return True

    def _note_due(self) -> None:
        due_ns, release_ns = self._player.next_change_ns, self._release_ns
        if release_ns is not None and (due_ns is None or release_ns < due_ns):
            due_ns = release_ns
        self._due_ns = math.inf if due_ns is None else due_ns

    def _command(
        self,
        report_index: int | None,
        state_ns: int,
        stamps: tuple[int, int, int] | None,
        command_ns: int | None = None,
    ) -> None:
        """Hand the command of a new state to the link, in place of one not sent yet, unless it plays already.

        `stamps` are those up to FRAME, where a report caused it; `command_ns` is when it was known, if not now.
        """
        self.counters.state_changes += 1
        is_click = self._click_ns is not None
        command = self._renderer.render(self._state, self._level_db, is_click)
        state = (state_ns, report_index, self._state, self._level_db, is_click, self._touches)
        if command == self._held and (self._pending is None or self._is_sent()):
            # Sent anew, it would begin anew: fade out and in; and silence would cut a click that still plays.
            self._settle()
            if self._trace is not None:
                self._trace.append(_Pending(*state, 0, None).change(None))
            return
        if self._pending is not None:
            self._settle()
        sent_before = self._link.counters.sent
        self._held = command if isinstance(command, DriveCommand) else SILENCE
        command.hand_to(self._link)
        handed = None if stamps is None else (*stamps, state_ns, command_ns or self._now_ns())
        self._pending = _Pending(*state, sent_before, handed)

    def _keep_link(self, readable: Container[int] | None) -> None:
        """Move bytes while there is a port; what was lost is found again, or ends the run."""
        if not self._port:
            self._look_for_port()
            return
        try:
            self._move_bytes(readable)
        except LinkLostError:
            if self._reopening is None:
                raise
            self._lose_port(self._reopening)

    def _look_for_update(self, updates: Updates, readable: Container[int] | None) -> None:
        """Another table: its bank goes over while the old one plays; then all changes at once, between two frames."""
        if readable is None or updates.fileno() in readable:
            rendering = updates.poll()
            if rendering is not None and rendering.renderer.suits_device_of(self._renderer):
                self._next, self._is_handed_over, self._needs_session = rendering, False, False
        coming, link = self._next, self._link
        if coming is None or self._is_handed_over or link.state is not LinkState.READY:
            return
        if self._needs_session or replace(coming.configuration, bank=None) != replace(link.configuration, bank=None):
            self._change_session(coming)
        elif coming.bank is None or coming.bank_data == self._bank_data:
            self._swap(coming)
        else:
            link.replace_bank(coming.bank, coming.bank_data)
            self._is_handed_over = True

    def _change_session(self, coming: Rendering) -> None:
        """Other limits, or a device without room for two banks: a new session, in a moment that nobody touches."""
        if self._release_ns is not None or self._player.next_change_ns is not None:
            return
        self._swap(coming)
        self._link.reconfigure(coming.configuration)
        self._session.connect()

    def _swap(self, coming: Rendering) -> None:
        self.counters.swaps += 1
        self._next = None
        self._renderer, self._bank_data = coming.renderer, coming.bank_data
        self._tracker = FingerTracker(coming.device, self._digitizer.surface)
        if self._fast is not None:
            self._fast.refit(self._tracker, coming.fast_table)
        self._player.click_length_ns = coming.click_length_ns
        waits = self._pending is not None and not self._is_sent()
        if waits or (self._level_db is not None and self._click_ns is None):
            self._command_by_time()

    def _lose_port(self, reopening: Reopening) -> None:
        self.counters.losses += 1
        if self._is_sent():
            self._settle()
        self._session.lose_port()
        self._watch(())
        reopening.lose(self._now_ns())

    def _look_for_port(self) -> None:
        """A port that is back begins with the whole handshake; what is to play by then goes out once it is armed."""
        port = None if self._reopening is None else self._reopening.poll(self._now_ns())
        if port is not None:
            self.counters.reconnects += 1
            self._session.move_to(port)
            self._watch((port.fileno(),))

    def _watch(self, port: tuple[int, ...]) -> None:
        """Wait for the descriptor of the port, if there is one, and for that of the touches."""
        touch = self._source.fileno()
        self._port = port
        self._port_and_touch = port if touch is None else (*port, touch)
        if self._updates is not None:
            self._port_and_touch += (self._updates.fileno(),)

    def _move_bytes(self, readable: Container[int] | None = None) -> None:
        """Write first: a fresh command does not wait for what the device says."""
        session = self._session
        session.send()
        if self._pending is not None and not session.wants_to_write() and self._is_sent():
            self._settle()
        if readable is None or self._port[0] in readable:
            for event in session.receive():
                self._act_on(event)
        else:
            session.check_patience()
        if self._link.state in _ENDED:
            self._act_on_stop()

    def _is_sent(self) -> bool:
        return self._pending is not None and self._link.counters.sent != self._pending.sent_before

    def _settle(self, settled_ns: int | None = None) -> None:
        """End of the pending change: written, replaced, or never to be sent; now, if no time is given."""
        pending, settled_ns = self._pending, settled_ns or self._now_ns()
        if pending is None:
            return
        is_sent = self._is_sent()
        self._pending = None
        self.counters.commands += is_sent
        if is_sent and self._ring is not None:
            stamps = None if pending.stamps is None else (*pending.stamps, settled_ns)
            self._sent = _Sent(pending.report_index, pending.time_ns, stamps, self._link.drive_sequence)
        if is_sent and pending.stamps and self._latency is not None and not self._session.wants_to_write():
            self._latency.record((*pending.stamps, settled_ns))
        if self._trace is not None:
            self._trace.append(pending.change(self._link.drive_sequence if is_sent else None))

    def _note(self, time_ns: int, report_index: int | None, report: bytes) -> None:
        """Keep what there is to tell until the command of the pass is written: nobody waits for a record."""
        is_click = self._click_ns is not None
        self._news.append(_News(time_ns, report_index, self._state, self._level_db, is_click, self._touches, report))

    def _tell(self, ring: RingWriter) -> None:
        """Records of the pass; a command that left later than its report has one more, without the report."""
        sent, self._sent = self._sent, None
        if sent is not None and all(news.report_index != sent.report_index for news in self._news):
            self._note(sent.time_ns, sent.report_index, b"")
        counters, link = self.counters, self._link.counters
        counts = (
            counters.reports,
            counters.frames,
            counters.state_changes,
            counters.commands,
            link.coalesced,
            self._digitizer.counters.lost_frames,
        )
        drive = self._held.drive
        for time_ns, index, state, level_db, is_click, touches, report in self._news:
            stamps, sequence = (0, time_ns, 0, 0, 0, 0), None
            if sent is not None and sent.report_index == index:
                stamps, sequence = sent.stamps or stamps, sent.sequence
            ring.write(stamps, index, state, level_db, is_click, sequence, counts, touches, drive, report)
        self._news.clear()

    def _act_on(self, event: Event) -> None:
        match event:
            case Armed():
                self._resume()
            case BankReplaced() if self._next is not None:
                self._swap(self._next)
            case BankRefused():
                self._is_handed_over, self._needs_session = False, True
            case Greeted() if not self._renderer.fits(event.capabilities):
                raise LinkError("another device answered than the one this run began with: start the run again")
            case FaultReceived() if not self._reconnect:
                raise LinkError(f"the device disarmed itself ({event.fault.name}): see to it, then start the run again")

    def _resume(self) -> None:
        """What is to play by now goes out to a device that was armed again; a click is over."""
        self._is_handed_over = False
        if self._pending is not None and self._pending.is_click:
            self._settle()
        if self._held != SILENCE or self._pending is not None:
            self._held.hand_to(self._link)

    def _act_on_stop(self) -> None:
        if not self._reconnect:
            raise LinkError("the device is not armed: it was rebooted or stopped; see to it, then start the run again")
        # The acknowledgement of a fault goes out first: the device repeats the fault until it comes.
        if self._link.next_deadline_ns() is None and not self._session.wants_to_write():
            self.counters.reconnects += 1
            self._session.connect()

    def _silence(self) -> None:
        """Leave no drive, whatever is touched, and wait until the port has taken that."""
        if self._state:
            self._state, self._level_db, self._click_ns = 0, None, None
            self._command(None, self._now_ns(), None)
        while self._pending is not None and self._link.state is LinkState.READY:
            _wait_for_link(self._session, self._clock)
            self._move_bytes()

    def _stop(self) -> None:
        self._link.stop(self._now_ns())
        while self._link.state is LinkState.STOPPING:
            _wait_for_link(self._session, self._clock)
            self._session.send()
            self._session.receive()


def _wait_for_link(session: Session, clock: Clock) -> None:
    port = (session.port.fileno(),)
    clock.wait(_link_deadline_ns(session, clock), port, port if session.wants_to_write() else ())


def _link_deadline_ns(session: Session, clock: Clock) -> int | None:
    if session.wants_to_write():
        return clock.now_ns() + BLOCKED_LINE_NS
    return session.link.next_deadline_ns()
