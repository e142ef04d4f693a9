"""Clicks that no table holds (three fingers and more): asked for when they are wanted, and taken when they are solved.

A solver beside the loop takes longer than a loop may wait. So the loop asks, goes on, and the touch that waits is
answered when the click comes. Where the solver has ended, the pipeline awaits nothing any more.
"""

from collections.abc import Callable, Container, Sequence
from typing import Protocol

from engine.device import Device
from engine.loop.observer import LoopCounters
from engine.loop.pipeline import Pipeline
from engine.render.link_commands import Command
from engine.table import ClickEntry
from engine.touch import Placement


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
