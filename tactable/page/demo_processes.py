"""The two processes behind the demo's page: the emulated firmware, asked once a tick, and the engine with its ring."""

import asyncio
import contextlib
import os
from pathlib import Path

from base.child import ChildError
from base.plain import to_plain
from engine.touch.sources.pointer import PointerFeed
from firmware_link.emulator import emulator_process
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.emulator_process import Applied, decode_applied
from tactable.page.processes.asynchronous import AsyncChild
from tactable.page.processes.engine_process import Order, ProgramsAt


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
        arguments = {"configuration": to_plain(configuration), "link": ""}
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
        self.child, self.feed, self.ring = child, feed, ring

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

    async def play(self, order: Order) -> tuple[list[str], int]:
        """Play another order; once it is ready, what to print and its first record in the ring. Raises ChildError."""
        self.child.write({"order": order})
        answer = await self.child.read()
        return answer["lines"], answer["first_record"]

    async def end(self) -> None:
        """End the process."""
        self.feed.close()
        await self.child.end()
        self.ring.unlink(missing_ok=True)
