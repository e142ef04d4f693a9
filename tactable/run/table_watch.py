"""Finds new tables for a running loop: a child process verifies and renders each one, and hands it over by a pipe.

Verifying and rendering take up to seconds, which the loop must not spend. It only reads the pipe, piece by piece, and
never waits for it. If the child dies, the run goes on with the table that it has.

A rendered table is some megabytes of arrays. They travel behind the pickle that refers to them and are read where they
will stay, so that taking the table over copies nothing and holds the loop for a tenth of a millisecond.
"""

import os
import pickle
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from base.child import Parent
from base.files import identity_of
from base.printable import write_note
from engine.device import DeviceError
from engine.effects.rules import Effects
from engine.loop.fast.fast_layout import FastRendering, with_fast_table
from engine.render.board_fit import RendererError
from engine.render.limits import LimitError
from engine.render.prepared import Rendering, render_table
from engine.table import Table, TableError
from firmware_link.host.link_values import Capabilities
from tactable.run.beside_loop import BesideLoop

LOOK_S = 0.3  # time between two looks at the file
_READ_BYTES = 1 << 16
WORD = struct.Struct("<Q")  # the size that leads a message
# A child that fails writes a line of text as its last words, whose first bytes are a larger number.
_MOST_BYTES = 1 << 40
_ALIGNMENT = 64  # arrays begin at multiples of it, as NumPy lays them out


@dataclass(frozen=True)
class Watched:
    """The watched file, and everything that the rendering of a new table depends on."""

    path: Path
    identity: tuple[int, int, int]  # identity of the table that plays; a new table is another file under the same name
    zones: tuple[str, ...]
    effects: Effects
    capabilities: Capabilities
    refuses: bool
    bit_rate_hz: int


class Messages:
    """Messages of a pipe that never waits, each led by its size: read piece by piece, where they will stay."""

    def __init__(self, descriptor: int, most_bytes: int = _MOST_BYTES) -> None:
        """A message that claims more than `most_bytes` ends the messages."""
        self._descriptor, self._most_bytes = descriptor, most_bytes
        os.set_blocking(descriptor, False)
        self._is_size = True
        self._expect(WORD.size)

    def read(self) -> memoryview | None:
        """Read at most 64 KiB; a message once its last part has come. Raises EOFError at the end of the messages."""
        try:
            count = os.readv(self._descriptor, [self._expected[self._received : self._received + _READ_BYTES]])
        except BlockingIOError:
            return None
        if not count:
            raise EOFError
        self._received += count
        if self._received < len(self._expected):
            return None
        whole, is_size = self._expected, self._is_size
        size = WORD.unpack(whole)[0] if is_size else WORD.size
        is_text = size > self._most_bytes
        self._is_size = is_text or not is_size
        self._expect(WORD.size if is_text else size)
        if is_text:
            raise EOFError
        return None if is_size else whole

    def _expect(self, size: int) -> None:
        self._expected, self._received = memoryview(bytearray(size)), 0


class TableWatch(BesideLoop):
    """The child process, and the end of its pipe that the loop reads."""

    def __init__(self, watched: Watched) -> None:
        super().__init__("tactable.run.table_watch", {"watched": watched}, "the watch for new tables")
        self._messages = Messages(self._descriptor)

    def poll(self) -> Rendering | None:
        """Read at most 64 KiB; returns a table once its last part has come."""
        try:
            message = self._messages.read()
        except EOFError:
            self._fall_silent(
                "new tables are no longer watched for: the watching process has ended; start the run again to adopt one"
            )
            return None
        return None if message is None else _unpacked(message)


class TableLook:
    """Looks at the file: each new table once, rendered; one that is refused is reported and skipped."""

    def __init__(self, watched: Watched) -> None:
        self._watched, self._seen = watched, watched.identity

    def take_new(self) -> FastRendering | None:
        """The rendering of a table that is new since the last look."""
        try:
            found = identity_of(self._watched.path)
        except OSError:
            return None  # the file is being replaced, or was removed: the run keeps its table
        if found == self._seen:
            return None
        self._seen = found
        try:
            return _rendered(self._watched)
        except (TableError, DeviceError, RendererError, LimitError, OSError) as error:
            write_note(f"the new table is refused, the one before plays on: {error}")
            return None


def serve(watched: Watched, parent: Parent) -> None:
    """Hand over each new table until the other end closes."""
    look = TableLook(watched)
    while not parent.has_spoken(LOOK_S):
        if (rendering := look.take_new()) is not None:
            parent.say_bytes(_packed(rendering))
            for text in (f"a new table is verified and handed over: {watched.path}", *rendering.fit.notes):
                write_note(text)


def _rendered(watched: Watched) -> FastRendering:
    with Table.open(watched.path) as table:
        zones = tuple(zone.name for zone in table.device.zones)
        if zones != watched.zones:
            was = ", ".join(watched.zones)
            raise TableError(f"{watched.path}: has zones {', '.join(zones)}, the run began with {was}: start it again")
        fits = watched.effects, watched.capabilities, watched.bit_rate_hz
        return with_fast_table(render_table(table, *fits, refuses=watched.refuses), watched.capabilities)


def _packed(rendering: Rendering) -> bytes:
    """The size of the rest; number and sizes of its parts; the parts: the pickle, and the arrays that it refers to."""
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(rendering, protocol=pickle.HIGHEST_PROTOCOL, buffer_callback=buffers.append)
    parts = [memoryview(data), *(buffer.raw() for buffer in buffers)]
    words = [len(parts), *(part.nbytes for part in parts)]
    packed = bytearray(b"".join(map(WORD.pack, words)))
    for part in parts:
        packed += bytes(-len(packed) % _ALIGNMENT)
        packed += part
    return WORD.pack(len(packed)) + packed


def _unpacked(packed: memoryview) -> Rendering:
    """The rendering of what `_packed` gave, without the first size; its arrays stay in this memory."""
    (count,) = WORD.unpack_from(packed)
    parts, at = [], WORD.size * (1 + count)
    for number in range(1, 1 + count):
        (size,) = WORD.unpack_from(packed, WORD.size * number)
        at += -at % _ALIGNMENT
        parts.append(packed[at : at + size])
        at += size
    rendering = pickle.loads(parts[0], buffers=parts[1:])  # from our own process
    assert isinstance(rendering, Rendering)
    return rendering


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The process behind a `TableWatch`."""
    os.nice(10)
    serve(arguments["watched"], parent)
