"""The control process as the loop sees it: a slot with at most one control step, and a word back when it was taken.

The process sends a step only after the one before was told, so the loop reads at most one step a pass, whatever
programs send. Steps are values of our own process, pickled behind their size, and read piece by piece.
"""

import base64
import contextlib
import os
import pickle
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from engine.effects import ControlStep, Effects, Outcome
from firmware_link.child import Child
from firmware_link.host.link_values import Capabilities
from tactable.run.table_watch import Messages


@dataclass(frozen=True)
class ControlOf:
    """What the control process serves, and where."""

    socket: Path
    ring: Path
    table: Path
    effects: Effects
    """The rules that the run begins with."""
    port: int | None = None
    """The loopback port of the WebSocket, 0 for any; None: no WebSocket."""
    osc_port: int | None = None
    """The loopback port of Open Sound Control, 0 for any; None: no Open Sound Control."""
    is_watched: bool = True
    """Whether the run changes over to another table at the same path."""


class ControlProcess:
    """The child process, and the slot that the loop reads (engine.loop.ControlSlot). Raises ChildError."""

    def __init__(self, served: ControlOf) -> None:
        arguments = {"served": _as_text(served)}
        self._child = Child("tactable.control.process", arguments, name="the control channel")
        try:
            self.lines: list[str] = self._child.read()["lines"]
            """What to print: where it is reached."""
        except BaseException:
            self._child.kill()
            raise
        self.process_id = self._child.process_id
        self._descriptor = self._child.fileno()
        self._is_there = True
        self._messages = Messages(self._descriptor)

    def __enter__(self) -> "ControlProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.set_blocking(self._descriptor, True)
        self._child.end()

    def begin(self, capabilities: Capabilities) -> None:
        """Take steps from now on; the device is connected. The process hands none over before."""
        self._child.write({"board": [capabilities.frequency_resolution_hz, list(capabilities.full_scales_m)]})

    def change_run(self, table: Path, effects: Effects) -> None:
        """Say that another run follows, of this table and with these rules; programs and their regions go on in it."""
        self._child.write({"run": {"table": str(table), "effects": _as_text(effects)}})

    def fileno(self) -> int:
        """The descriptor that is readable when a part of a step has come."""
        return self._descriptor

    def poll(self) -> ControlStep | None:
        """Read at most 64 KiB; a step once its last part has come."""
        try:
            message = self._messages.read()
        except (EOFError, ConnectionResetError):
            self._end()
            return None
        if message is None:
            return None
        step = pickle.loads(message)  # from our own process
        assert isinstance(step, ControlStep)
        return step

    def tell(self, outcome: Outcome) -> None:
        """Say what became of the step; it always finds room, since one step is answered at a time."""
        if self._is_there:
            with contextlib.suppress(BlockingIOError):
                self._child.write({"outcome": outcome})

    def _end(self) -> None:
        """Replace the socket of a child that died by a silent one, so that the run goes on."""
        sys.stderr.write("note: programs are no longer heard: the control process has ended; start the run again\n")
        sys.stderr.flush()
        self._is_there = False
        silent, self._kept_open = os.pipe()
        os.dup2(silent, self._descriptor)
        os.close(silent)
        os.set_blocking(self._descriptor, False)


def _as_text(value: ControlOf | Effects) -> str:
    return base64.b64encode(pickle.dumps(value)).decode()
