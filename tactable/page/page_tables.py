"""Tables for the page's switches: their places in the cache, and a child process that builds missing ones."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from base.child import ChildError
from engine.device import Device
from tactable.page.processes.asynchronous import AsyncChild
from tactable.page.processes.build_process import BuildOrder
from tactable.rig.ready import cached_table


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
