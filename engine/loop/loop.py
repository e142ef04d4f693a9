"""The loop: one thread that waits once for touches, the link and time, and runs the pipeline for each report.

One pass is: wait; read every report that is there and run the pipeline on it; let time act; write the newest command;
take in what the device says; look for a new table and for a step of a program; notify the observer. The order carries
the guarantees:

- *Latest wins.* After a stall the ring of hidraw holds up to 63 reports. All are taken before anything is written, so a
  device gets one fresh command and no stale ones.
- *Write before read.* A fresh command does not wait for the parsing of what the device says.
- *Time after reports.* What is due before a report is taken before it; what is due now is taken after the last one.
- *Observe after the write.* Records go to the observer at the end of the pass.

The loop allocates little, logs nothing and catches no broad error: it counts. One thread, because another Python thread
in this process would hold the interpreter for up to 10 ms.
"""

import select
import time
from collections.abc import Container, Sequence
from typing import Protocol

from engine.loop.beside import AwaitedClicks, ClickSolving, Controls, ControlSlot, TableSwap, Updates
from engine.loop.dispatcher import Dispatcher, Reconnection, Reopening
from engine.loop.observer import CommandRecord, Fate, Observer
from engine.loop.pipeline import Pipeline
from engine.render.renderer import SILENCE, Command
from engine.steady.cases import MeasuredFinger
from engine.touch.sources import Source
from firmware_link.host.link_values import Armed, Capabilities, Event, LinkState
from firmware_link.host.session import Session
from firmware_link.protocol.link_errors import LinkError, LinkLostError

NS_PER_S = 1_000_000_000
REPORTS_PER_PASS = 64  # the ring of hidraw holds 63 reports; the link never waits for more
# A line that takes nothing is tried again this often, so that the patience of the link still ends.
BLOCKED_LINE_NS = 5_000_000
_new = tuple.__new__  # the hot path: half the time of calling a named tuple's class


class Clock(Protocol):
    """Time, and waiting for it: the system's, or a test's own."""

    def now_ns(self) -> int:
        """Monotonic; the session must be given the same."""

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int] | None:
        """Wait for a descriptor until `until_ns` at most; those that can be read, None where that is not known."""


class SystemClock:
    """The monotonic clock; waits in the system."""

    now_ns = staticmethod(time.monotonic_ns)  # monotonic time; it is called several times between touch and command

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int]:
        """Wait with `select`, which counts in us: `poll` rounds up to whole ms, half a ms late for a playback."""
        timeout_s = None if until_ns is None else max(0, until_ns - time.monotonic_ns()) / NS_PER_S
        return select.select(readable, writable, (), timeout_s)[0]


class Listener(Protocol):
    """Takes what the link heard, such as the samples of the board's accelerometer."""

    def begin_stream(self) -> None:
        """A stream of samples begins."""

    def take_event(self, event: Event) -> None:
        """Take an event."""


class Measuring(Listener, Protocol):
    """Measures fingers beside the loop, perhaps by the board's accelerometer."""

    @property
    def is_listening(self) -> bool:
        """Whether the board is to stream its samples."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def poll(self) -> Sequence[MeasuredFinger] | None:
        """All fingers that are known now, where that is news; None: it is not. Never waits."""


class StopRequest(Protocol):
    """What ends a run; `threading.Event` has it. The loop looks at each wake-up, at most 80 ms apart."""

    def is_set(self) -> bool:
        """Whether to end."""


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
    """Runs the touches of one source through one pipeline to one link that `connect` made ready.

    `observer` gets a record for each report and each change that time brought. With `reconnect` a device that
    stopped itself is greeted and armed again; with `reopening` a lost port is waited for while touches are read
    (`engine.loop.dispatcher`). With `updates` the loop changes to each table that comes (`engine.loop.beside`), and
    with `solving` it gets the clicks that no table holds (`engine.loop.beside`). With `control` programs decide
    who feels what (`engine.loop.beside`). With `measuring` steady drives are solved for fingers as it measured
    them.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        dispatcher: Dispatcher,
        source: Source,
        clock: Clock,
        observer: Observer | None = None,
        *,
        reconnect: bool = False,
        reopening: Reopening | None = None,
        updates: Updates | None = None,
        solving: ClickSolving | None = None,
        control: ControlSlot | None = None,
        measuring: Measuring | None = None,
    ) -> None:
        session = dispatcher.session
        self.counters = dispatcher.counters
        self._pipeline, self._dispatcher, self._session = pipeline, dispatcher, session
        self._source, self._clock, self._observer = source, clock, observer
        self._now_ns, self._measuring = clock.now_ns, measuring
        self._reconnection = Reconnection(session, self.counters, reconnect, reopening)
        taking = (pipeline, self.counters, self._hand_over)
        self._swap = None if updates is None else TableSwap(updates, pipeline, session, self._table_changed)
        self._awaited = None if solving is None else AwaitedClicks(solving, *taking)
        self._controls = None if control is None else Controls(control, *taking)
        self._measured: Sequence[MeasuredFinger] = ()
        beside = [each.descriptor for each in (self._swap, self._awaited, self._controls) if each is not None]
        # Those that may be read beside the port.
        others = (source.fileno(), *beside, None if measuring is None else measuring.fileno())
        self._others = tuple(descriptor for descriptor in others if descriptor is not None)

    def run(self, stop: StopRequest | None = None) -> None:
        """Run until source, contacts and effects have ended, or `stop` is set; then silence and a STOP.

        Raises LinkError when the port or the device fails; counters and records are final then too.
        """
        try:
            self._begin_stream()
            while not self._is_over(stop):
                readable = self._wait()
                self._read_touches()
                if self._awaited is not None:
                    self._awaited.look(readable)
                self._keep_link(readable)
                if self._swap is not None:
                    self._swap.look(readable)
                if self._controls is not None:
                    self._take_control(self._controls, readable)
                if self._measuring is not None:
                    self._take_fingers(self._measuring, readable)
                self._notify()
            self._silence()
            self._stop()
        except LinkError:
            self._session.link.disconnect()
            raise
        finally:
            self._dispatcher.settle()
            self._notify()

    def _is_over(self, stop: StopRequest | None) -> bool:
        return (stop is not None and stop.is_set()) or (self._source.ended and self._pipeline.is_at_rest)

    # ---- waiting ----

    def _wait(self) -> Container[int] | None:
        """Wait until a report, something from the device, a new table, or a deadline comes."""
        source, session, pipeline = self._source, self._session, self._pipeline
        now_ns = self._now_ns()
        deadlines_ns = [_link_deadline_ns(session, now_ns), source.next_time_ns()]
        deadlines_ns.append(self._reconnection.next_attempt_ns(now_ns))
        if not pipeline.is_at_rest:
            deadlines_ns.append(source.clock_time_ns(int(pipeline.due_ns)))
        until_ns = min((deadline_ns for deadline_ns in deadlines_ns if deadline_ns is not None), default=None)
        port = (session.port.fileno(),) if self._reconnection.has_port else ()
        readable = port if source.ended else (*port, *self._others)
        return self._clock.wait(until_ns, readable, port if session.wants_to_write() else ())

    # ---- reading ----

    def _read_touches(self) -> None:
        """Every report that is there, in order; time acts by itself only on a source that has no more."""
        source, now_ns = self._source, self._now_ns()
        for _ in range(REPORTS_PER_PASS):
            report = source.read(now_ns)
            if report is None:
                break
            self._take_report(report)
        else:
            return
        self._let_time_act(source.source_time_ns(now_ns))

    def _take_report(self, report: bytes) -> None:
        source, pipeline, dispatcher, now_ns = self._source, self._pipeline, self._dispatcher, self._now_ns
        read_ns, time_ns = now_ns(), source.report_time_ns
        self.counters.reports += 1
        # After a stall, or in a playback that does not wait, what was due before may be seen only now.
        if pipeline.due_ns <= time_ns:
            self._let_time_act(time_ns)
        command = pipeline.step(report, time_ns)
        if command is None:
            fate, stamps_ns = Fate.NONE, (0, read_ns, 0, 0, 0, 0)
        else:
            fate = dispatcher.hand_over(command)
            available_ns = source.clock_time_ns(time_ns)
            stamps_ns = (available_ns, read_ns, pipeline.frame_ns, pipeline.state_ns, now_ns(), 0)
        self._note(stamps_ns, source.report_index, report, fate)

    def _let_time_act(self, source_time_ns: int) -> None:
        if self._pipeline.due_ns <= source_time_ns:
            for command in self._pipeline.commands_due(source_time_ns):
                self._hand_over(command)

    def _take_control(self, controls: Controls, readable: Container[int] | None) -> None:
        """The step of a program, and its command before the program hears of it."""
        step = controls.take_step(readable)
        if step is None:
            return
        source_time_ns = self._source.source_time_ns(self._now_ns())
        self._let_time_act(source_time_ns)
        controls.run(step, source_time_ns)
        try:
            self._keep_link(())
        finally:  # the next run takes the next step of the same process
            controls.tell_outcome()

    def _take_fingers(self, measuring: Measuring, readable: Container[int] | None) -> None:
        """Hand new measurements of fingers to the solver of steady drives, and solve the drive that plays again."""
        measured = measuring.poll() if readable is None or measuring.fileno() in readable else None
        if measured is not None:
            self._measured, wanted = measured, self._pipeline.wanted
            self._pipeline.answerer.renderer.steady.take_fingers(measured)
            if wanted.level_db is not None and wanted.click_ns is None:
                self._hand_over(self._pipeline.command())

    def _hand_over(self, command: Command, *, ends_click: bool = False) -> None:
        """A command that no report caused."""
        fate = self._dispatcher.hand_over(command, ends_click=ends_click)
        self._note((0, self._now_ns(), 0, 0, 0, 0), None, b"", fate)

    def _note(self, stamps_ns: Sequence[int], report_index: int | None, report: bytes, fate: Fate) -> None:
        pipeline, dispatcher = self._pipeline, self._dispatcher
        placement, level_db, click_ns = pipeline.wanted
        frame, drive = None if report_index is None else pipeline.frame, dispatcher.held.drive
        is_click, touches = click_ns is not None, pipeline.touches
        wanted = (placement, level_db, is_click, touches)
        play = dispatcher.play if fate is Fate.WAITING else b""
        effect = "" if placement is None else pipeline.effect
        rest = (drive, fate, None, play, effect)
        dispatcher.note(_new(CommandRecord, (stamps_ns, report_index, report, frame, *wanted, *rest)))

    def _notify(self) -> None:
        """Give the records of the pass to the observer, after its command was written."""
        counters, pipeline, observer = self.counters, self._pipeline, self._observer
        records = self._dispatcher.take_records()
        counters.replaced = self._session.link.counters.coalesced
        digitizer = pipeline.digitizer.counters
        counters.frames, counters.lost_frames = digitizer.frames, digitizer.lost_frames
        counters.joined, counters.left_out = pipeline.joined, pipeline.left_out
        if observer is not None:
            for record in records:
                observer.observe(record, counters)

    # ---- writing ----

    def _keep_link(self, readable: Container[int] | None) -> None:
        """Move bytes while there is a port; a port that was lost is found again, or ends the run."""
        reconnection = self._reconnection
        if not reconnection.has_port:
            reconnection.look_for_port(self._now_ns())
            return
        try:
            self._move_bytes(readable)
        except LinkLostError as error:
            if self._dispatcher.is_sent:
                self._dispatcher.settle()
            reconnection.lose_port(error, self._now_ns())

    def _move_bytes(self, readable: Container[int] | None = None) -> None:
        session = self._session
        session.send()
        self._dispatcher.settle_if_written()
        if readable is None or session.port.fileno() in readable or session.must_receive():
            for event in session.receive():
                self._act_on(event)
        self._reconnection.greet_again_if_stopped()

    def _act_on(self, event: Event) -> None:
        self._reconnection.check(event, self._pipeline.answerer.renderer)
        if self._swap is not None:
            self._swap.act_on(event)
        if isinstance(event, Armed):
            self._dispatcher.resume()
            self._begin_stream()
        elif self._measuring is not None and self._measuring.is_listening:
            self._measuring.take_event(event)

    def _begin_stream(self) -> None:
        if self._measuring is not None and self._measuring.is_listening:
            self._measuring.begin_stream()
            self._session.link.start_sensing(self._now_ns())

    def _table_changed(self) -> None:
        """Play a steady drive, or a command that waits, from the new table; a click that sounds ends as it began.

        A drive ends where its fingers are not on the bar of the new table.
        """
        self.counters.swaps += 1
        self._pipeline.answerer.renderer.steady.take_fingers(self._measured)
        wanted, dispatcher = self._pipeline.wanted, self._dispatcher
        waits = dispatcher.is_pending and not dispatcher.is_sent
        is_driven = wanted.level_db is not None or dispatcher.held != SILENCE
        if waits or (is_driven and wanted.click_ns is None):
            self._hand_over(self._pipeline.command())

    # ---- the end ----

    def _silence(self) -> None:
        """Leave no drive, whatever is touched, and wait until the port has taken that."""
        command = self._pipeline.silence()
        if command is not None:
            self._hand_over(command)
        while self._dispatcher.is_pending and self._session.link.state is LinkState.READY:
            _wait_for_link(self._session, self._clock)
            self._move_bytes()

    def _stop(self) -> None:
        session = self._session
        session.link.stop(self._now_ns())
        while session.link.state is LinkState.STOPPING:
            _wait_for_link(session, self._clock)
            session.send()
            session.receive()


def _wait_for_link(session: Session, clock: Clock) -> None:
    port = (session.port.fileno(),)
    clock.wait(_link_deadline_ns(session, clock.now_ns()), port, port if session.wants_to_write() else ())


def _link_deadline_ns(session: Session, now_ns: int) -> int | None:
    return now_ns + BLOCKED_LINE_NS if session.wants_to_write() else session.link.next_deadline_ns()
