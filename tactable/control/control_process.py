"""The control process: serves programs beside a run, at a Unix socket and perhaps at a WebSocket.

It has its own interpreter, so that nothing that programs send takes time from the loop; the two share the ring, which
the loop writes anyway, and the slot of `tactable.control.slot`.
"""

import asyncio
import contextlib
import fcntl
import os
import socket
import stat
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from base.child import ChildError, Parent
from base.files import identity_of
from base.printable import printable, write_note
from engine.effects.rules import Outcome
from engine.loop.ring import RingReader
from engine.table import Table, TableError
from tactable.control.control_server import ControlServer
from tactable.control.events import Board, Events
from tactable.control.requests import MOST_BYTES, ControlError, Scene
from tactable.control.slot import ControlOf
from tactable.control.web import WebControl
from tactable.run.table_watch import LOOK_S, WORD
from tactable.shipped import named_effects

if TYPE_CHECKING:
    from tactable.control.osc import OscControl

_READ_BYTES = 1 << 16
EVENTS_EVERY_S = 0.004  # time between two looks at the ring while a program wants events
_NICE = 2
_OPTION = "choose another place with --control-socket"


class _LoopSlot:
    """The loop's slot: one part of a step at a time, and the word that it was taken."""

    def __init__(self, parent: Parent, begin: Callable[[dict[str, Any]], None]) -> None:
        """`begin` gets what the parent says of the board and of the next run."""
        self._parent, self._begin = parent, begin
        self.is_open = asyncio.Event()
        self.has_ended = asyncio.Event()
        self._outcome: asyncio.Future[Outcome] | None = None
        asyncio.get_running_loop().add_reader(parent.fileno(), self._hear)

    async def hand_over(self, part: bytes) -> Outcome:
        """Give a part to the loop and wait for its outcome. Raises ControlError when the run has ended."""
        await self.is_open.wait()
        if self.has_ended.is_set():
            raise ControlError("run: the run has ended")
        self._outcome = asyncio.get_running_loop().create_future()
        self._parent.say_bytes(WORD.pack(len(part)) + part)
        return await self._outcome

    def _hear(self) -> None:
        document = self._parent.read()
        if document is None:
            asyncio.get_running_loop().remove_reader(self._parent.fileno())
            self.is_open.set()
            self.has_ended.set()
            if self._outcome is not None and not self._outcome.done():
                self._outcome.set_exception(ControlError("run: the run has ended"))
        elif "board" in document or "run" in document:
            self._begin(document)
            self.is_open.set()
        elif self._outcome is not None and not self._outcome.done():
            self._outcome.set_result(Outcome(document["outcome"]))


class _StreamConnection:
    """A program at the Unix socket."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer

    def send(self, line: bytes) -> None:
        if not self._writer.is_closing():
            self._writer.write(line)

    async def drain(self) -> None:
        await self._writer.drain()

    def unread_bytes(self) -> int:
        return self._writer.transport.get_write_buffer_size()


async def _lines_of(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Lines without their ends; of one that is too long its first part, which is refused for its length."""
    kept, is_too_long = bytearray(), False
    while data := await reader.read(_READ_BYTES):
        kept += data
        *lines, rest = kept.split(b"\n")
        for line in lines:
            if not is_too_long:
                yield bytes(line)
            is_too_long = False
        kept = rest
        if len(kept) > MOST_BYTES:
            if not is_too_long:
                yield bytes(kept)
            kept, is_too_long = bytearray(), True


async def _publish(
    server: ControlServer, events: Events, reader: RingReader, table_path: Path, *, is_watched: bool
) -> None:
    """Send events until cancelled, and adopt another table at the same path where the run does."""
    clock, identity = asyncio.get_running_loop().time, identity_of(table_path)
    look_s = clock()
    while True:
        await asyncio.sleep(EVENTS_EVERY_S if server.wanted_streams else 10 * EVENTS_EVERY_S)
        server.publish(events.read(reader.read(), has_promises="played" in server.wanted_streams))
        if not is_watched or clock() < look_s:
            continue
        look_s = clock() + LOOK_S
        with contextlib.suppress(OSError, TableError):  # being replaced, or not usable: the run ignores it too
            found = identity_of(table_path)
            if found != identity:
                identity, before = found, events.table
                adopted = await asyncio.to_thread(Table.open, table_path)
                if events.adopt(adopted):
                    server.adopt(adopted.device)
                    before.close()
                else:
                    adopted.close()


async def _begin_run(server: ControlServer, events: Events, table: str) -> None:
    """Go on in another run, of this table; a bar with other zones ends all regions."""
    before = events.table
    with contextlib.suppress(OSError, TableError):  # replaced already: the next run is announced
        events.table = await asyncio.to_thread(Table.open, Path(table), verify=False)
        before.close()
    server.adopt(events.table.device)
    if [zone.name for zone in before.device.zones] != [zone.name for zone in events.table.device.zones]:
        await server.remove_regions()


async def _open_osc(server: ControlServer, port: int) -> "tuple[OscControl, str]":
    """The OSC port of a server, and the line that says where it is. Raises ChildError."""
    from tactable.control.osc import PREFIX, OscControl  # only here is python-osc needed

    osc = OscControl(server)
    return osc, f"control: osc://127.0.0.1:{await osc.open(port)}{PREFIX}..."


async def serve(served: ControlOf, table: Table, reader: RingReader, parent: Parent) -> None:
    """Say where programs reach the run, then serve them until the parent asks for the end. Raises ChildError."""
    scene = Scene(named_effects())
    events = Events(table, scene.top_region_at)
    runs = set[asyncio.Task[None]]()

    def begin_run(document: dict[str, Any]) -> None:
        if "board" in document:
            resolution_hz, full_scales_m = document["board"]
            events.board = Board(resolution_hz, tuple(full_scales_m))
        else:
            task = asyncio.create_task(_begin_run(server, events, document["run"]))
            runs.add(task)
            task.add_done_callback(runs.discard)

    slot = _LoopSlot(parent, begin_run)
    server = ControlServer(scene, table.device, slot.hand_over, events.fingers)
    talks: dict[asyncio.StreamWriter, asyncio.Task[None]] = {}

    async def talk(stream: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            await server.converse(_lines_of(stream), _StreamConnection(writer))
            await writer.drain()
        writer.close()
        talks.pop(writer, None)

    def begin(stream: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        talks[writer] = asyncio.create_task(talk(stream, writer))

    listening = listening_socket(served.socket)
    lines = [f"control: {printable(str(served.socket))}"]
    web: WebControl | None = None
    osc: OscControl | None = None
    try:
        if served.port is not None:
            web = WebControl(server, served.port)
            lines.append(f"control: {web.address}")
        if served.osc_port is not None:
            osc, line = await _open_osc(server, served.osc_port)
            lines.append(line)
        unix = await asyncio.start_unix_server(begin, sock=listening)
        publishing = asyncio.create_task(_publish(server, events, reader, served.table, is_watched=served.is_watched))
        ended = asyncio.create_task(slot.has_ended.wait())
        beside = [publishing, ended, *([] if web is None else [asyncio.create_task(web.run())])]
        parent.say({"lines": lines})
        done, others = await asyncio.wait(beside, return_when=asyncio.FIRST_COMPLETED)
        if web is not None:
            web.end()
        publishing.cancel()
        if osc is not None:
            await osc.close()
            if osc.messages:
                write_note(osc.summary)
        unix.close()
        for writer in talks:
            writer.close()  # the talk ends as if the program had hung up
        await asyncio.gather(*talks.values(), *others, return_exceptions=True)
        for task in done:
            task.result()
    finally:
        served.socket.unlink(missing_ok=True)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say where programs reach the run, then serve them until it ends."""
    os.nice(_NICE)  # the loop comes first
    served: ControlOf = arguments["served"]
    with RingReader(served.ring) as reader, Table.open(served.table, verify=False) as table:
        asyncio.run(serve(served, table, reader, parent))


def listening_socket(path: Path, owner_id_of: Callable[[Path], int] = lambda path: path.stat().st_uid) -> socket.socket:
    """A Unix socket that only its user reaches, in place of one that an ended run left. Raises ChildError."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        # Of two runs that begin at once neither takes a socket that the other one has just made.
        fcntl.flock(folder, fcntl.LOCK_EX)
        if owner_id_of(path.parent) not in (0, os.getuid()):
            raise ChildError(f"{path.parent}: belongs to another user: {_OPTION}")
        _remove_left_over(path)
        return _bound(path)
    finally:
        os.close(folder)


def _remove_left_over(path: Path) -> None:
    """Remove the socket of an ended run. Raises ChildError where a run still listens, or the file is no socket."""
    if not path.exists():
        return
    if not stat.S_ISSOCK(path.stat().st_mode):
        raise ChildError(f"{path}: is no socket: {_OPTION}")
    with socket.socket(socket.AF_UNIX) as other:
        try:
            other.connect(str(path))
        except OSError:
            path.unlink()
        else:
            raise ChildError(f"{path}: another run listens there: {_OPTION}")


def _bound(path: Path) -> socket.socket:
    listening = socket.socket(socket.AF_UNIX)
    before = os.umask(0o177)
    try:
        listening.bind(str(path))
    except OSError as error:
        listening.close()
        raise ChildError(f"{path}: no control socket can be made there ({error}): {_OPTION}") from error
    finally:
        os.umask(before)
    listening.listen()
    return listening
