"""The control process as the loop sees it: a slot with at most one control step, and a word back when it was taken.

The process sends a part of a step only after the one before was told, so the loop reads at most one part a pass,
whatever programs send. Parts have the form of `tactable.control.steps`, behind their size, and are read piece by piece.
"""

import contextlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from base.child import Child
from base.plain import to_plain
from base.printable import printable
from engine.effects import ControlStep, Outcome
from firmware_link.host.link_values import Capabilities
from tactable.control.steps import MOST_BYTES, StepDecoder, StepError
from tactable.run.table_watch import Messages


@dataclass(frozen=True)
class ControlOf:
    """What the control process serves, and at which addresses."""

    socket: Path
    ring: Path
    table: Path
    port: int | None = None
    """The loopback port of the WebSocket, 0 for any; None: no WebSocket."""
    osc_port: int | None = None
    """The loopback port of Open Sound Control, 0 for any; None: no Open Sound Control."""
    is_watched: bool = True
    """Whether the run changes over to another table at the same path."""

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> "ControlOf":
        """The value from what `to_plain` made of it."""
        paths = {key: Path(plain[key]) for key in ("socket", "ring", "table")}
        return cls(**{**plain, **paths})


class ControlProcess:
    """The child process, and the slot that the loop reads (engine.loop.ControlSlot). Raises ChildError."""

    def __init__(self, served: ControlOf, start: Callable[..., Child] = Child) -> None:
        self._child = start("tactable.control.process", to_plain(served), name="the control channel")
        self._decoder = StepDecoder()
        try:
            self.lines: list[str] = self._child.read()["lines"]
            """What to print: where it is reached."""
        except BaseException:
            self._child.kill()
            raise
        self.process_id = self._child.process_id
        self._descriptor = self._child.fileno()
        self._is_there = True
        self._messages = Messages(self._descriptor, MOST_BYTES)

    def __enter__(self) -> "ControlProcess":
        return self

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

    def fileno(self) -> int:
        """The descriptor that is readable when something of a part has come."""
        return self._descriptor

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
        """Replace the socket of a child that died by a silent one, so that the run goes on; what programs held ends."""
        sys.stderr.write(f"note: programs are no longer heard: {printable(why)}; start the run again\n")
        sys.stderr.flush()
        self._is_there = False
        silent, self._kept_open = os.pipe()
        os.dup2(silent, self._descriptor)
        os.close(silent)
        os.set_blocking(self._descriptor, False)
        self._decoder = StepDecoder()
        return replace(self._decoder.scene, are_all_gone=True)
