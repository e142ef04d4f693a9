"""Finds new tables for a running loop: a child process verifies and renders each one, and hands it over by a pipe.

Verifying and rendering take up to seconds, which the loop must not spend. It only reads the pipe, piece by piece, and
never waits for it. If the child dies, the run goes on with the table that it has.
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
from engine.loop.fast.table import with_fast_table
from engine.render import LimitError, RendererError, Rendering, WhenNotAchieved, render_table
from engine.table import Table, TableError
from firmware_link.child import Child, Parent
from firmware_link.host.link_values import Capabilities

LOOK_S = 0.3
"""Time between two looks at the file."""
_READ_BYTES = 1 << 16
_HEAD = struct.Struct("<Q")


@dataclass(frozen=True)
class Watched:
    """The watched file, and everything that the rendering of a new table depends on."""

    path: Path
    identity: tuple[int, int, int]
    """Identity of the table that plays; a new table is another file under the same name."""
    zones: tuple[str, ...]
    effects: Effects
    capabilities: Capabilities
    when_not_achieved: WhenNotAchieved
    bit_rate_hz: int


def identity_of(path: Path) -> tuple[int, int, int]:
    """Inode, modification time and size: another file has another identity."""
    status = path.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


class TableWatch:
    """The child process, and the end of its pipe that the loop reads."""

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
        """The descriptor that is readable when a part of a table has come."""
        return self._pipe

    def poll(self) -> Rendering | None:
        """Read at most 64 KiB; returns a table once its last part has come."""
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
        """Replace the pipe of a child that died by a silent one, so that the run goes on."""
        _say("new tables are no longer watched for: the watching process has ended; start the run again to adopt one")
        silent, self._kept_open = os.pipe()
        os.dup2(silent, self._pipe)
        os.close(silent)
        os.set_blocking(self._pipe, False)


def serve(watched: Watched, parent: Parent) -> None:
    """Hand over each new table until the other end closes; a table that is refused is reported and skipped."""
    seen = watched.identity
    while not parent.has_spoken(LOOK_S):
        try:
            found = identity_of(watched.path)
        except OSError:
            continue  # the file is being replaced, or was removed: the run keeps its table
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
        rendering = render_table(
            table, watched.effects, watched.capabilities, watched.when_not_achieved, watched.bit_rate_hz
        )
        return with_fast_table(rendering, watched.capabilities)


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
