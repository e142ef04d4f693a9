"""New tables for a run that goes on: another process sees them come, verifies and renders them, and hands them over.

The process of the run only ever reads from a pipe, and never waits for it.
"""

import base64
import os
import pickle
import struct
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from engine.device import DeviceError
from engine.effects import Effects
from engine.render.limits import LimitError
from engine.render.prepared import Rendering, render_table
from engine.render.renderer import RendererError, WhenNotAchieved
from engine.table import Table, TableError
from firmware_link.child import Child, Parent
from firmware_link.host.link_values import Capabilities

LOOK_S = 0.3
"""The table is looked at this often."""
_READ_BYTES = 1 << 16
_HEAD = struct.Struct("<Q")


@dataclass(frozen=True)
class Watched:
    """What is looked at, and for whom."""

    path: Path
    identity: tuple[int, int, int]
    """Of the table that plays: a new one takes its place as another file."""
    zones: tuple[str, ...]
    effects: Effects
    capabilities: Capabilities
    when_not_achieved: WhenNotAchieved
    bit_rate_hz: int


def identity_of(path: Path) -> tuple[int, int, int]:
    """Which file lies there."""
    status = path.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


class TableWatch:
    """The end of the pipe that a loop looks at, and the process behind it."""

    def __init__(self, watched: Watched) -> None:
        arguments = {"watched": base64.b64encode(pickle.dumps(watched)).decode()}
        self._child = Child("tactable.run.table_watch", arguments, name="the watch for new tables")
        self._pipe = self._child.fileno()
        os.set_blocking(self._pipe, False)
        self._received = bytearray()

    def __enter__(self) -> "TableWatch":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.kill()

    def fileno(self) -> int:
        """Readable when a part of a table has come."""
        return self._pipe

    def poll(self) -> Rendering | None:
        """The table whose last part has come; at most 64 KiB a call are taken."""
        try:
            part = os.read(self._pipe, _READ_BYTES)
        except BlockingIOError:
            return None
        if not part:
            self._end()
        self._received += part
        if len(self._received) < _HEAD.size:
            return None
        end = _HEAD.size + _HEAD.unpack_from(self._received)[0]
        if len(self._received) < end:
            return None
        rendering = pickle.loads(self._received[_HEAD.size : end])  # from our own process
        del self._received[:end]
        assert isinstance(rendering, Rendering)
        return rendering

    def _end(self) -> None:
        """The process has died: the run goes on with a pipe that nothing comes through."""
        _say("new tables are no longer looked for: the process that did has ended; start the run again for them")
        silent, self._kept_open = os.pipe()
        os.dup2(silent, self._pipe)
        os.close(silent)
        os.set_blocking(self._pipe, False)


def serve(watched: Watched, parent: Parent) -> None:
    """Hand over each new table until the other end closes; one that fails is told and left."""
    seen = watched.identity
    while not parent.has_spoken(LOOK_S):
        try:
            found = identity_of(watched.path)
        except OSError:
            continue  # it is away for a moment, or for good: what plays goes on
        if found == seen:
            continue
        seen = found
        try:
            data = _packed(_rendered(watched))
        except (TableError, DeviceError, RendererError, LimitError, OSError) as error:
            _say(f"the new table is refused, the one before plays on: {error}")
            continue
        parent.say_bytes(data)
        _say(f"a new table is verified and handed over: {watched.path}")


def _rendered(watched: Watched) -> Rendering:
    with Table.open(watched.path) as table:
        zones = tuple(zone.name for zone in table.device.zones)
        if zones != watched.zones:
            was = ", ".join(watched.zones)
            raise TableError(f"{watched.path}: has zones {', '.join(zones)}, the run began with {was}: start it again")
        return render_table(
            table, watched.effects, watched.capabilities, watched.when_not_achieved, watched.bit_rate_hz
        )


def _packed(value: object) -> bytes:
    data = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
    return _HEAD.pack(len(data)) + data


def _say(text: str) -> None:
    sys.stderr.write(f"note: {text}\n")
    sys.stderr.flush()


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The process behind a `TableWatch`."""
    os.nice(10)
    watched = pickle.loads(base64.b64decode(arguments["watched"]))  # from our own process
    assert isinstance(watched, Watched)
    serve(watched, parent)
