"""What comes to a running loop from processes beside it: tables, solved clicks, and control steps of programs.

None of them makes the loop wait: each has a descriptor, and is looked at only when that can be read.

**Tables** (`TableSwap`). A new table comes verified and rendered, so the loop only has to change its look-up between
two frames and, where it differs, to bring the basis of clicks over. Three ways, by what differs from the table that
plays:

1. Same limits, same basis (or no clicks): the pipeline changes at once. This is the ordinary case, since the basis
   depends on actuators, bands and lengths of clicks only, not on what was solved.
2. Same limits, another basis: it goes over in pieces while clicks of the old one play; the pipeline changes when the
   device confirms. A device that is armed again meanwhile lost the transfer, and it begins again.
3. Other limits, or a device that has no room for two bases: a new session, and that only while no finger is down and
   no effect is under way, because the device falls silent for the handshake.

A newer table replaces one that is under way. A table that was encoded for another wire is ignored.

**Clicks** that no table holds (`AwaitedClicks`; three fingers and more). The loop asks for one when it is wanted and
goes on, and the touch that waits is answered when the click comes. Where the solver has ended, the pipeline awaits
nothing any more.

**Control steps** (`Controls`). Programs talk to a process which checks what they say and puts one step at a time into a
slot. A step is taken after the frame of the pass was written: an answer of the compiled step is confirmed by then, and
the rules that it used are those that the Python step used. The outcome is told after the step's own command was
written.
"""

from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from typing import Protocol

from engine.device import Device
from engine.effects.rules import ControlStep, Outcome
from engine.loop.observer import LoopCounters
from engine.loop.pipeline import Pipeline
from engine.render.prepared import Rendering
from engine.render.renderer import Command
from engine.table import ClickEntry
from engine.touch import Placement
from firmware_link.host.link_values import Armed, BasisRefused, BasisReplaced, Event, LinkState
from firmware_link.host.session import Session
from firmware_link.protocol.basis import Basis


class Updates(Protocol):
    """Source of new tables while a loop runs."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def poll(self) -> Rendering | None:
        """The newest table, once it is here whole; never waits."""


class TableSwap:
    """Brings new tables to one pipeline and the basis of its device; `on_swap` is called after each change."""

    def __init__(self, updates: Updates, pipeline: Pipeline, session: Session, on_swap: Callable[[], None]) -> None:
        self.descriptor = updates.fileno()
        self._updates, self._pipeline, self._session = updates, pipeline, session
        self._on_swap = on_swap
        self._coming: Rendering | None = None
        self._is_handed_over = self._needs_session = False

    def look(self, readable: Container[int] | None) -> None:
        """Take a table that has come, and go on with the one that is under way; `readable` None: not known."""
        if readable is None or self.descriptor in readable:
            rendering = self._updates.poll()
            if rendering is not None and rendering.renderer.suits_device_of(self._pipeline.answerer.renderer):
                self._coming, self._is_handed_over, self._needs_session = rendering, False, False
        coming, link = self._coming, self._session.link
        if coming is None or self._is_handed_over or link.state is not LinkState.READY:
            return
        if self._needs_session or replace(coming.configuration, basis=None) != replace(link.configuration, basis=None):
            if self._pipeline.is_at_rest:
                self._swap(coming)
                link.reconfigure(coming.configuration)
                self._session.connect()
        elif coming.basis is None or _is_same(coming.basis, link.configuration.basis):
            self._swap(coming)
        else:
            link.replace_basis(coming.basis)
            self._is_handed_over = True

    def act_on(self, event: Event) -> None:
        """Follow what the device says of the basis."""
        match event:
            case Armed():
                self._is_handed_over = False
            case BasisReplaced() if self._coming is not None:
                self._swap(self._coming)
            case BasisRefused():
                self._is_handed_over, self._needs_session = False, True

    def _swap(self, coming: Rendering) -> None:
        self._coming = None
        self._pipeline.change_table(coming)
        self._on_swap()


def _is_same(one: Basis, other: Basis | None) -> bool:
    return other is not None and one.hash == other.hash


class ControlSlot(Protocol):
    """Source of control steps; none of its methods waits."""

    def scene(self) -> ControlStep:
        """What programs want already when the loop begins: it holds from the first touch on."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def poll(self) -> ControlStep | None:
        """The step in the slot, once it is here whole. The next one comes after `tell_outcome`."""

    def tell_outcome(self, outcome: Outcome) -> None:
        """Say what became of the step."""


class Controls:
    """Takes the steps of one slot into one pipeline; `hand_over` gets the command of a step, where it has one.

    Its keyword `ends_click`: a click that sounds does not play to its end.
    """

    def __init__(
        self, slot: ControlSlot, pipeline: Pipeline, counters: LoopCounters, hand_over: Callable[..., None]
    ) -> None:
        self.descriptor = slot.fileno()
        self._slot, self._pipeline, self._counters, self._hand_over = slot, pipeline, counters, hand_over
        self._outcome, _ = pipeline.control(slot.scene(), 0)  # of the last step

    def take_step(self, readable: Container[int] | None) -> ControlStep | None:
        """The step that has come; `readable` None: not known."""
        return self._slot.poll() if readable is None or self.descriptor in readable else None

    def run(self, step: ControlStep, time_ns: int) -> None:
        """Take a step; what is due by `time_ns`, on the source's time axis, was taken before."""
        self._counters.controlled += 1
        self._outcome, command = self._pipeline.control(step, time_ns)
        if command is not None:
            self._hand_over(command, ends_click=not self._pipeline.player.scene.settings.is_enabled)

    def tell_outcome(self) -> None:
        """Say what became of the step, after its command was written."""
        self._slot.tell_outcome(self._outcome)


class ClickSolving(Protocol):
    """Solver of clicks beside a loop; none of its methods waits."""

    @property
    def is_there(self) -> bool:
        """Whether questions are answered: not before the solver is ready, and not after its end."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def ask_for_click(self, placement: Placement, device: Device) -> None:
        """Ask for the click of a placement on a device; only the latest question is answered."""

    def poll(self) -> Sequence[tuple[str, ClickEntry]]:
        """The clicks that were solved since the last call, each with the fingerprint of its device."""


class AwaitedClicks:
    """Asks for the clicks that one pipeline awaits, and hands each that comes in time to `hand_over`."""

    def __init__(
        self, solving: ClickSolving, pipeline: Pipeline, counters: LoopCounters, hand_over: Callable[[Command], None]
    ) -> None:
        self.descriptor = solving.fileno()
        self._solving, self._pipeline, self._counters, self._hand_over = solving, pipeline, counters, hand_over
        self._asked: tuple[Placement, Device] | None = None
        pipeline.answerer.awaits_clicks = solving.is_there

    def look(self, readable: Container[int] | None) -> None:
        """Take what was solved, and ask for what is awaited; `readable` None: not known."""
        pipeline = self._pipeline
        if readable is None or self.descriptor in readable:
            for fingerprint, click in self._solving.poll():
                if fingerprint == pipeline.device.fingerprint:
                    self._counters.learned += 1
                    command = pipeline.learn(click)
                    if command is not None:
                        self._hand_over(command)
            if self._solving.is_there:
                pipeline.answerer.awaits_clicks = True
            elif pipeline.answerer.awaits_clicks:
                command = pipeline.stop_awaiting()
                if command is not None:
                    self._hand_over(command)
        awaited = pipeline.answerer.awaited
        question = None if awaited is None else (awaited, pipeline.device)
        if question is not None and question != self._asked:
            self._solving.ask_for_click(*question)
        self._asked = question
