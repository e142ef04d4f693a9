"""The control process as the loop sees it: a slot with at most one control step, and a word back when it was taken.

The process sends a part of a step only after the one before was told, so the loop reads at most one part a pass,
whatever programs send. Parts have the form of `tactable.control.steps`, behind their size, and are read piece by piece.
"""

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from base.child import Child
from engine.effects.rules import ControlStep, Outcome
from firmware_link.host.link_values import Capabilities
from tactable.control.steps import MOST_BYTES, StepDecoder, StepError
from tactable.run.beside_loop import BesideLoop
from tactable.run.table_watch import Messages


@dataclass(frozen=True)
class ControlOf:
    """What the control process serves, and at which addresses."""

    socket: Path
    ring: Path
    table: Path
    port: int | None = None  # the loopback port of the WebSocket, 0 for any; None: no WebSocket
    osc_port: int | None = None  # the loopback port of Open Sound Control, 0 for any; None: no Open Sound Control
    is_watched: bool = True  # whether the run changes over to another table at the same path


class ControlProcess(BesideLoop):
    """The child process, and the slot that the loop reads (engine.loop.beside.ControlSlot). Raises ChildError."""

    def __init__(self, served: ControlOf, start: Callable[..., Child] = Child) -> None:
        super().__init__("tactable.control.control_process", {"served": served}, "the control channel", start)
        self._decoder = StepDecoder()
        try:
            self.lines: list[str] = self._child.read()["lines"]  # what to print: where it is reached
        except BaseException:
            self._child.kill()
            raise
        self._is_there = True
        self._messages = Messages(self._descriptor, MOST_BYTES)

    def __exit__(self, *unused: object) -> None:
        os.set_blocking(self._descriptor, True)
        self._child.end()

    def begin_steps(self, capabilities: Capabilities) -> None:
        """Take parts from now on; the device is connected. The process hands none over before."""
        self._child.write({"board": [capabilities.frequency_resolution_hz, list(capabilities.full_scales_m)]})

    def change_run(self, table: Path) -> None:
        """Say that another run follows, of this table; programs and their regions go on in it."""
        self._child.write({"run": str(table)})

    def scene(self) -> ControlStep:
        """Present settings of all programs for the whole bar."""
        return self._decoder.scene

    def poll(self) -> ControlStep | None:
        """Read at most one part; the step that it has, None where others follow."""
        try:
            part = self._messages.read()
            step = None if part is None else self._decoder.decode(part)
        except (EOFError, ConnectionResetError):
            return self._end("the control process has ended")
        except StepError as error:
            return self._end(str(error))
        if part is not None and step is None:
            self.tell_outcome(Outcome.DONE)
        return step

    def tell_outcome(self, outcome: Outcome) -> None:
        """Say what became of the step; it always finds room, since one step is answered at a time."""
        if self._is_there:
            with contextlib.suppress(BlockingIOError):
                self._child.write({"outcome": outcome})

    def _end(self, why: str) -> ControlStep:
        """Go on without the child; what programs held ends."""
        self._fall_silent(f"programs are no longer heard: {why}; start the run again")
        self._is_there = False
        self._decoder = StepDecoder()
        return replace(self._decoder.scene, are_all_gone=True)
