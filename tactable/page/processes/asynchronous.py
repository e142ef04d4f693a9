"""Child processes for an event loop: the protocol of `base.child`, awaited; engine, firmware and builds of the demo."""

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from base.child import ChildError, Document, command_of, decode_line, encode_line, ending_text
from engine.device import Device
from engine.loop.ring import Record, RingReader
from engine.touch.sources.pointer import PointerFeed
from firmware_link.emulator import emulator_process
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.emulator_process import Applied, decode_applied
from tactable.page.processes.build_process import BuildOrder
from tactable.page.processes.engine_process import Order, ProgramsAt
from tactable.rig.ready import cached_table

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


class FirmwareProcess:
    """The process of the emulated firmware, asked once a tick."""

    def __init__(self, child: AsyncChild, port: str, configuration: DeviceConfiguration) -> None:
        self.child, self.port, self.configuration = child, port, configuration
        self._answers: list[Applied] = []
        self._is_asked = False
        self._reader = asyncio.create_task(self._read())

    @classmethod
    async def start(cls, configuration: DeviceConfiguration) -> "FirmwareProcess":
        """Raises ChildError when it does not start."""
        arguments = {"configuration": configuration, "link": ""}
        child = await AsyncChild.start(emulator_process.MODULE, arguments, name="the emulated firmware")
        return cls(child, (await child.read())["port"], configuration)

    async def _read(self) -> None:
        with contextlib.suppress(ChildError):  # `_follow` sees that the child has ended
            while True:
                answer = await self.child.read()
                self._is_asked = False
                self._answers.append(decode_applied(answer))

    def take_answers(self) -> list[Applied]:
        """The answers since the last call; asks for the next one."""
        answers, self._answers = self._answers, []
        if not self._is_asked and self.child.is_running:
            self._is_asked = True
            self.child.write({"do": "take"})
        return answers

    async def end(self) -> None:
        """End the process."""
        self._reader.cancel()
        await self.child.end()


class EngineProcess:
    """The process of the engine, its end of the pointers' pipe, and its ring."""

    def __init__(self, child: AsyncChild, feed: PointerFeed, ring: Path) -> None:
        self.child, self.feed, self._ring = child, feed, ring
        self._reader: RingReader | None = None

    @classmethod
    async def start(cls, ring: Path, programs: ProgramsAt | None) -> "EngineProcess":
        """Start a process that waits for orders; its ring exists once the first order plays."""
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        try:
            arguments = {"pointer_pipe": reading, "ring": str(ring), "programs": programs}
            module = "tactable.page.processes.engine_process"
            child = await AsyncChild.start(module, arguments, name="the engine", descriptors=[reading])
        finally:
            os.close(reading)
        return cls(child, PointerFeed(writing), ring)

    async def play(self, order: Order) -> list[str]:
        """Play another order; once it is ready, what to print. Raises ChildError and RingError."""
        self.child.write({"order": order})
        answer = await self.child.read()
        if self._reader is None:
            self._reader = RingReader(self._ring, from_start=True)
        self._reader.skip_to(answer["first_record"])  # what the run before saw last is no finger of this one
        lines: list[str] = answer["lines"]
        return lines

    def records(self) -> Iterable[Record]:
        """What came into the ring since the last call; nothing before the first order plays."""
        return () if self._reader is None else self._reader.read()

    async def end(self) -> None:
        """End the process."""
        if self._reader is not None:
            self._reader.close()
        self.feed.close()
        await self.child.end()
        self._ring.unlink(missing_ok=True)


@dataclass(frozen=True)
class Building:
    """Progress of a build; `error` says why it was given up."""

    device: str
    step: str = "starting"
    fraction: float = 0.0
    error: str | None = None


def order_for(device_name: str, device: Device, folder: Path, work: Path) -> BuildOrder:
    """What to build for a device: the table that `tactable demo` without a page plays too; its first one in `work`."""
    return BuildOrder(device_name, cached_table(device, folder), work / f"first-clicks-{device.fingerprint[:12]}.nc")


class Builder:
    """Builds one table at a time in a child process; calls `on_change` whenever its state changed."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.now: Building | None = None  # the build under way, or why no table is built
        self.has_compiled = False  # whether a build has compiled the kernels, so that other processes load them at once
        self._on_change = on_change
        self._order: BuildOrder | None = None
        self.built = set[BuildOrder]()
        self._task: asyncio.Task[None] | None = None
        self._stopped = set[asyncio.Task[None]]()  # whose process may still be ending

    def order_build(self, order: BuildOrder) -> None:
        """Build this table now. A build under way is stopped; it continues from its parts when ordered again."""
        if order == self._order:
            return
        self.stop()
        self._order, self.now = order, Building(order.device)
        if order in self.built:
            self.now = replace(self.now, error="what was built does not suit this program any more: start it again")
            return
        self._task = asyncio.create_task(self._build(order))

    def forgive(self) -> None:
        """Allow a failed build to be tried again."""
        if self.now is not None and self.now.error is not None:
            self.stop()

    def stop(self) -> None:
        """Stop the build under way."""
        if self._task is not None:
            self._task.cancel()
            self._stopped.add(self._task)
            self._task.add_done_callback(self._stopped.discard)
        self._order = self._task = self.now = None

    async def end(self) -> None:
        """Stop the build under way, and wait until the processes of all that were stopped have ended."""
        self.stop()
        await asyncio.gather(*self._stopped, return_exceptions=True)

    async def _build(self, order: BuildOrder) -> None:
        child = await AsyncChild.start("tactable.page.processes.build_process", {"order": order}, name="the build")
        try:
            await self._follow(child, order)
        except ChildError as error:
            self.now = Building(order.device, error=str(error))
            self._on_change()
        finally:
            await child.end(by_signal=True)

    async def _follow(self, child: AsyncChild, order: BuildOrder) -> None:
        while True:
            answer = await child.read()
            if "compiled" in answer:
                self.has_compiled = True
            elif "step" in answer:
                self.now = Building(order.device, answer["step"], answer["fraction"])
            elif Path(answer["usable"]) == order.path:
                self.built.add(order)
                self._order = self.now = None
                self._on_change()
                return
            self._on_change()
