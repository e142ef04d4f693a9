"""The tables that the page's switches ask for: where they are, whether they are sound, and who builds one."""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from engine.device import Device
from engine.table import Table, TableError
from firmware_link.child import ChildError
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.entries.objective import DEFAULT_OBJECTIVE
from tactable.page.choices import Source
from tactable.page.processes.asynchronous import AsyncChild
from tactable.page.processes.build import BuildOrder
from tactable.rig.demo import DEMO_FINGERS


@dataclass(frozen=True)
class Building:
    """How far a table is; `error` is why it is given up."""

    device: str
    objective: str
    step: str = "starting"
    fraction: float = 0.0
    error: str | None = None


def order_for(device_name: str, device: Device, source: Source, folder: Path) -> BuildOrder:
    """The table of a device for a source; that of our own objective is the one that `tactable demo` has cached."""
    is_ours = source.objective == DEFAULT_OBJECTIVE
    path = cached_table(device, folder)
    if not is_ours:
        path = path.with_name(f"{path.stem}-{source.objective}{path.suffix}")
    return BuildOrder(device_name, source.objective, DEMO_FINGERS if is_ours else 0, path)


def cached_table(device: Device, folder: Path) -> Path:
    """Where the table of a device is kept."""
    return folder / f"{device.name}-{device.fingerprint[:12]}.nc"


def open_newest(order: BuildOrder, device: Device) -> Table | None:
    """The table of an order, or else the one that has no clicks yet; None where there is none that is sound."""
    for path in (order.path, order.early_path):
        with contextlib.suppress(TableError):
            return Table.open(path, device=device, code_fingerprint=code_fingerprint(), verify=False)
    return None


class Builder:
    """One table after another, each in its own process; `on_change` is called whenever there is something to tell."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.now: Building | None = None
        """What is being built, or why it is not."""
        self._on_change = on_change
        self._order: BuildOrder | None = None
        self._built = set[BuildOrder]()
        self._task: asyncio.Task[None] | None = None

    def ask(self, order: BuildOrder) -> None:
        """Build this one, now; what was being built is left, and goes on from there when it is asked for again."""
        if order == self._order:
            return
        self.stop()
        self._order, self.now = order, Building(order.device, order.objective)
        if order in self._built:
            self.now = replace(self.now, error="what was built does not suit this program any more: start it again")
            return
        self._task = asyncio.create_task(self._build(order))

    def has_built(self, order: BuildOrder) -> bool:
        """Whether this one was built and is there."""
        return order in self._built

    def forgive(self) -> None:
        """What failed may be tried again."""
        if self.now is not None and self.now.error is not None:
            self.stop()

    def stop(self) -> None:
        """Leave what is being built."""
        if self._task is not None:
            self._task.cancel()
        self._order = self._task = self.now = None

    async def _build(self, order: BuildOrder) -> None:
        child = await AsyncChild.start("tactable.page.processes.build", order.as_json(), name="the build")
        try:
            await self._follow(child, order)
        except ChildError as error:
            self.now = Building(order.device, order.objective, error=str(error))
            self._on_change()
        finally:
            await child.end(by_signal=True)

    async def _follow(self, child: AsyncChild, order: BuildOrder) -> None:
        while True:
            told = await child.read()
            if "step" in told:
                self.now = Building(order.device, order.objective, told["step"], told["fraction"])
            elif Path(told["usable"]) == order.path:
                self._built.add(order)
                self._order = self.now = None
                self._on_change()
                return
            self._on_change()
