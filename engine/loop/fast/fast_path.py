"""The fast path: a report is answered by the compiled step while the loop waits; the loop repeats and checks it.

Theory of operation
-------------------
The operating system wakes a process in 25 us. Python, its caches cold, then needs about 20 us from a report to its
command, and the compiled step (`step.c`) 2 us. So the wait itself is compiled: it sleeps, reads the report, and where
the report brings a new command, writes it at once.

The answer is speculative. Before each wait `Moment.write` copies what the step must know; the step changes nothing
that Python owns. After the wait the Python loop takes the same report through `Pipeline.step` and hands its command to
the link, whose frame for the time of the answer must be the same bytes. On a mismatch the device gets a new session,
and the run goes on without the fast path. What is rare (a lost report, a busy line, a report that is not the last) the
step declines, and the loop answers.

The loop knows nothing of this. The fast path stands at its four edges and passes everything else on:

- `FastPath` is the clock: its `wait` runs the compiled step;
- `FastPath.source` gives the loop the report that the step has read;
- `FastSession` compares the frame instead of writing it a second time;
- `FastPath` is the observer, too: the records get the times at which the step worked.
"""

import ctypes
import os
import weakref
from collections.abc import Container, Sequence
from typing import Protocol, runtime_checkable

from engine.effects.rules import Effects
from engine.loop.dispatcher import Dispatcher
from engine.loop.fast.fast_layout import NONE, Fast, FastRendering
from engine.loop.fast.library import FastPathError
from engine.loop.fast.moment import Answer, FastSession, Moment
from engine.loop.loop import Clock
from engine.loop.observer import CommandRecord, LoopCounters, Observer, Stage, Stamps
from engine.loop.pipeline import Pipeline
from engine.touch.sources import Source


@runtime_checkable
class PacketSource(Source, Protocol):
    """A source whose reports the compiled step may read: each read of a descriptor gives one packet with one report."""

    @property
    def packet_head(self) -> int:
        """Bytes before the report: 0, or 8 and more, of which the first 8 are the report's time."""

    def packet_fileno(self) -> int | None:
        """The file descriptor; None while the device is unplugged."""

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:
        """The report in a packet read at `now_ns`, as if `read` had given it. `is_last`: no other was behind it."""


class FastSource:
    """A packet source as the loop sees it: first the report that the compiled step has read, then the others."""

    def __init__(self, source: PacketSource, session: FastSession) -> None:
        self.name, self.descriptor = source.name, source.descriptor
        self.vendor_id, self.product_id, self.report_id = source.vendor_id, source.product_id, source.report_id
        self.fileno, self.next_time_ns, self.clock_time_ns = source.fileno, source.next_time_ns, source.clock_time_ns
        self.taken: Answer | None = None  # the answer whose packet `read` gives next
        self._source, self._session = source, session

    @property
    def ended(self) -> bool:
        """What the source says."""
        return self._source.ended

    @property
    def report_index(self) -> int:
        """What the source says."""
        return self._source.report_index

    @property
    def report_time_ns(self) -> int:
        """What the source says."""
        return self._source.report_time_ns

    def read(self, now_ns: int) -> bytes | None:
        """The report that was read during the wait; behind an answered one there was no other."""
        answer, self.taken = self.taken, None
        if answer is not None:
            return self._source.take_packet(answer.packet, answer.read_ns, is_last=bool(answer.frame))
        return None if self._session.answer is not None else self._source.read(now_ns)

    def source_time_ns(self, now_ns: int) -> int:
        """A clock time on the source's axis; until an answer is confirmed, time stands at its report.

        The step answers where nothing is due by the time of the report. A packet may state a time before it was read,
        and what became due in between must not take the place of the command that is confirmed.
        """
        return self._source.source_time_ns(now_ns) if self._session.answer is None else self._source.report_time_ns


class FastPath:
    """The compiled step of one run: give a loop its `source`, and the fast path itself as clock and observer.

    The dispatcher's session must be a FastSession. Raises FastPathError for a digitizer or rules that it cannot serve.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        source: PacketSource,
        pipeline: Pipeline,
        dispatcher: Dispatcher,
        clock: Clock,
        effects: Effects,
        rendering: FastRendering,
        observer: Observer | None = None,
    ) -> None:
        assert isinstance(dispatcher.session, FastSession)
        self.now_ns = clock.now_ns
        self.counters = dispatcher.session.fast_counters
        self.source = FastSource(source, dispatcher.session)
        self._library, self._clock, self._observer = library, clock, observer
        self._packets, self._pipeline, self._dispatcher = source, pipeline, dispatcher
        self._session = dispatcher.session
        timer = library.fast_open_timer()
        if timer < 0:
            raise FastPathError("the system gives no timer: the Python loop answers all reports")
        weakref.finalize(self, os.close, timer)
        self._moment = Moment(pipeline.digitizer, effects, source.packet_head, timer)
        self._moment.refit(pipeline, rendering.fast_table)
        self._rendering, self._effects = pipeline.rendering, pipeline.player.scene.effects
        self._surface = pipeline.digitizer.surface
        self._fast_table = rendering.fast_table
        self._answered: tuple[int, Answer] | None = None  # the report that was taken last, by its index

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int] | None:
        """Wait as the clock does, and answer a report meanwhile."""
        packets = None if writable or self.source.ended or self.counters.mispredicted else self._packets.packet_fileno()
        self._answered = None
        if packets is None:
            return self._clock.wait(until_ns, readable, writable)
        pipeline, touch = self._pipeline, self.source.fileno()
        is_fit = pipeline.rendering is self._rendering and pipeline.player.scene.effects is self._effects
        if not is_fit or pipeline.digitizer.surface is not self._surface:
            self._refit()
        descriptors = (packets, *(descriptor for descriptor in readable if descriptor != touch))
        now_ns = self.now_ns()
        axis_ns = self._packets.source_time_ns(now_ns) - now_ns
        self._moment.write(pipeline, self._dispatcher, self._session.fast_link, now_ns, axis_ns, descriptors)
        self._run(NONE if until_ns is None else until_ns)
        fast = self._moment.fast
        if fast.packet_size:
            self._take_answer()
        return [each for each, is_readable in zip(descriptors, fast.readable, strict=False) if is_readable]

    def _refit(self) -> None:
        """Answer by another table, by the rules of a program, or on another surface."""
        rendering = self._pipeline.rendering
        if rendering is not self._rendering:
            self._rendering = rendering
            self._fast_table = rendering.fast_table if isinstance(rendering, FastRendering) else None
        self._effects, self._surface = self._pipeline.player.scene.effects, self._pipeline.digitizer.surface
        self._moment.refit(self._pipeline, self._fast_table)

    def _run(self, until_ns: int) -> None:
        self._library.fast_wait(self._moment.address, until_ns)

    def _take_answer(self) -> None:
        fast = self._moment.fast
        packet = ctypes.string_at(self._moment.address + Fast.packet.offset, fast.packet_size)
        frame = ctypes.string_at(self._moment.address + Fast.frame.offset, fast.frame_size)
        times_ns = (fast.read_ns, fast.frame_ns, fast.state_ns, fast.asked_ns, fast.command_ns, fast.written_ns)
        answer = self.source.taken = Answer(packet, frame, fast.written, *times_ns)
        self._answered = (self.source.report_index + 1, answer)
        if frame:
            self._session.answer = answer

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:
        """Pass a record on with the times at which the compiled step worked."""
        if self._observer is None:
            return
        if self._answered is not None and self._answered[0] == record.report_index:
            record = record._replace(stamps_ns=_stamps_of(self._answered[1], record.stamps_ns))
        self._observer.observe(record, counters)


def _stamps_of(answer: Answer, stamps_ns: Stamps) -> Stamps:
    available_ns, _, *others_ns = stamps_ns
    if answer.frame:
        written_ns = answer.written_ns if stamps_ns[Stage.WRITTEN] else 0
        return available_ns, answer.read_ns, answer.frame_ns, answer.state_ns, answer.command_ns, written_ns
    return available_ns, answer.read_ns, *others_ns  # type: ignore[return-value]  # four of them
