"""A run for an experiment without hardware: the demo's engine and firmware, fingers that rest as asked. SIMULATED."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from base.points import parts_of
from base.work_folder import work_folder
from engine.table import Table
from engine.touch.sources.pointer import Phase, PointerEvent, PointerFeed
from tactable.page.choices import Choice
from tactable.page.processes.asynchronous import EngineProcess, FirmwareProcess
from tactable.page.processes.engine_process import Order, ProgramsAt
from tactable.rig.emulate import configuration_of

_MENTIONED_S = 0.2  # a pointer that is not mentioned for a second is released


class RestingFingers:
    """Fingers on the simulated surface; `rest` says where, and lifts those that rested elsewhere."""

    def __init__(self, feed: PointerFeed, corner_m: complex) -> None:
        self._feed, self._sides_m = feed, parts_of(corner_m)
        self._fingers: dict[int, tuple[float, ...]] = {}
        self._numbers = 0

    def rest(self, position_m: Sequence[complex]) -> None:
        """Rest at these points from now on."""
        places = [
            (*(part / side for part, side in zip(parts_of(at_m), self._sides_m, strict=True)), 0.5)[:2]
            for at_m in position_m
        ]
        if list(self._fingers.values()) == places:
            return
        self._send(Phase.UP)
        numbers = range(self._numbers, self._numbers + len(places))
        self._numbers = (self._numbers + len(places)) % 8  # of at most ten; two at a time
        self._fingers = dict(zip(numbers, places, strict=True))
        self._send(Phase.DOWN)

    async def stay(self, firmware: FirmwareProcess) -> None:
        """Mention the fingers now and then, until cancelled; take what the firmware did, so that it keeps no log."""
        while True:
            firmware.take_answers()
            await asyncio.sleep(_MENTIONED_S)
            self._send(Phase.MOVE)

    def _send(self, phase: Phase) -> None:
        if self._fingers:
            self._feed.send(*(PointerEvent(number, at[0], at[1], phase) for number, at in self._fingers.items()))


@asynccontextmanager
async def simulated_run(table: Table, socket: Path) -> AsyncIterator[Callable[[Sequence[complex]], None]]:
    """Run a table without hardware, its control channel at `socket`; yields what fingers are asked to rest by."""
    with work_folder("experiment", in_memory=True) as folder:
        firmware = await FirmwareProcess.start(configuration_of(table.device))
        engine = await EngineProcess.start(folder / "ring", ProgramsAt(str(socket)))
        fingers = RestingFingers(engine.feed, table.device.surface.corner_m)
        staying = asyncio.create_task(fingers.stay(firmware))
        try:
            choice = Choice(table.device.name)
            await engine.play(Order(table.path, firmware.port, choice, None, has_kernels=True, is_first=False))
            yield fingers.rest
        finally:
            staying.cancel()
            await asyncio.gather(staying, return_exceptions=True)
            with contextlib.suppress(OSError):
                await engine.end()
            await firmware.end()
