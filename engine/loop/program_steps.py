"""Control steps of programs, taken between two touch frames: from the slot of another process to the pipeline.

Programs talk to a process beside the loop, which checks what they say and puts one step at a time into a slot. The loop
looks at the slot only when its descriptor can be read, so an empty slot costs it one more descriptor in its wait. A
step is taken after the frame of the pass was written: an answer of the compiled step is confirmed by then, and the
rules that it used are those that the Python step used. The outcome is told after the step's own command was written.
"""

from collections.abc import Callable, Container
from typing import Protocol

from engine.effects.control_step import ControlStep, Outcome
from engine.loop.observer import LoopCounters
from engine.loop.pipeline import Pipeline


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
            self._hand_over(command, ends_click=not self._pipeline.player.settings.is_enabled)

    def tell_outcome(self) -> None:
        """Say what became of the step, after its command was written."""
        self._slot.tell_outcome(self._outcome)
