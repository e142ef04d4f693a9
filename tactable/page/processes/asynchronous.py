"""A child process for an event loop: the protocol of `base.child`, awaited."""

import asyncio
import contextlib
import socket
from collections.abc import Sequence

from base.child import ChildError, Document, command_of, decode_line, encode_line, ending_text

_LINE_BYTES = 1 << 22  # the emulated firmware says many clicks in one line
_END_TIMEOUT_S = 3.0  # less than base/child.py: somebody waits at a page


class AsyncChild:
    """A running child process; `end` it. `name` is what errors call it."""

    def __init__(
        self,
        process: asyncio.subprocess.Process,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        name: str,
    ) -> None:
        self.process, self._reader, self._writer, self._name = process, reader, writer, name

    @classmethod
    async def start(
        cls, module: str, arguments: Document, *, name: str, descriptors: Sequence[int] = ()
    ) -> "AsyncChild":
        """Run `main(parent, arguments)` of a module in a process of its own."""
        ours, theirs = socket.socketpair()
        with theirs:
            process = await asyncio.create_subprocess_exec(
                *command_of(module),
                stdin=theirs.fileno(),
                stdout=theirs.fileno(),
                pass_fds=descriptors,
                start_new_session=True,
            )
        child = cls(process, *await asyncio.open_connection(sock=ours, limit=_LINE_BYTES), name)
        child.write(arguments)
        return child

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self.process.returncode is None

    def write(self, document: Document) -> None:
        """Say a line; a child that has ended does not hear it."""
        self._writer.write(encode_line(document))

    async def read(self) -> Document:
        """The next line. Raises ChildError for last words, and for an end without any."""
        line = b""
        with contextlib.suppress(ConnectionResetError):  # ended with a line unread
            line = await self._reader.readline()
        if not line:
            raise ChildError(f"{self._name} {ending_text(await self.process.wait())}")
        return decode_line(line, self._name)

    async def end(self, *, by_signal: bool = False) -> None:
        """Close the stream, for a child that does not look at it also send SIGTERM; kill after 3 s."""
        self._writer.close()
        if by_signal and self.is_running:
            with contextlib.suppress(ProcessLookupError):
                self.process.terminate()
        try:
            await asyncio.wait_for(self.process.wait(), _END_TIMEOUT_S)
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                self.process.kill()
            await self.process.wait()
