"""The backend of the demo: the fingers of browsers drive the real engine, an emulated firmware and the bar. SIMULATED.

Two processes stand behind it: the engine, fed through a pipe with pointer events and watched through its ring, and the
emulated firmware, which is asked once a tick for what it drove. `tick` reads both and lets the simulated bar move; it
never waits. `run` is the only place that starts, changes or ends processes. It repeats `_follow`, which compares what
plays with what was chosen and makes up the difference, whenever a switch moved, a table became usable or a process
ended. A process that ended is a `ChildError`: everything is ended and started again, with growing pauses.
"""

import asyncio
import contextlib
import math
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from engine.device import Device, DeviceError
from engine.loop import RingError, RingReader
from engine.plain import to_plain
from engine.table import Table
from engine.touch.sources.pointer import PointerEvent, PointerFeed
from firmware_link.child import ChildError, ending_text
from tactable.page.choices import Choice, ChoiceError, Offered, Source, changed, hand_of
from tactable.page.live_bar import LiveBar
from tactable.page.messages import encode_picture
from tactable.page.paper_bar import PaperBar
from tactable.page.pointers import Pointers
from tactable.page.processes.asynchronous import AsyncChild
from tactable.page.processes.engine import Order
from tactable.page.processes.firmware import Applied, decode_applied
from tactable.page.scene import device_json
from tactable.page.tables import Builder, order_for
from tactable.page.view import View
from tactable.rig.emulate import configuration_of
from tactable.rig.ready import compare_with_shipped, is_outdated, open_cached
from tactable.shipped import find_device

SHORTEST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.25, 5.0


class _Firmware:
    """The process of the emulated firmware, asked once a tick."""

    def __init__(self, child: AsyncChild, port: str) -> None:
        self.child, self.port = child, port
        self._answers: list[Applied] = []
        self._is_asked = False
        self._reader = asyncio.create_task(self._read())

    @classmethod
    async def start(cls, device: Device) -> "_Firmware":
        """Raises ChildError when it does not start."""
        configuration = configuration_of(device)
        module = "tactable.page.processes.firmware"
        child = await AsyncChild.start(module, to_plain(configuration), name="the emulated firmware")
        return cls(child, (await child.read())["port"])

    async def _read(self) -> None:
        with contextlib.suppress(ChildError):  # `_follow` sees that the child has ended
            while True:
                answer = await self.child.read()
                self._is_asked = False
                self._answers.append(decode_applied(answer))

    def ask(self) -> list[Applied]:
        """The answers since the last call; asks for the next one."""
        answers, self._answers = self._answers, []
        if not self._is_asked and self.child.is_running:
            self._is_asked = True
            self.child.write({})
        return answers

    async def end(self) -> None:
        """End the process."""
        self._reader.cancel()
        await self.child.end()


class _Engine:
    """The process of the engine, its end of the pointers' pipe, and its ring."""

    def __init__(self, child: AsyncChild, feed: PointerFeed, ring: Path) -> None:
        self.child, self.feed, self.ring = child, feed, ring

    @classmethod
    async def start(cls, ring: Path) -> "_Engine":
        """Start a process that waits for orders; its ring exists once the first order plays."""
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        try:
            arguments = {"pointer_pipe": reading, "ring": str(ring)}
            module = "tactable.page.processes.engine"
            child = await AsyncChild.start(module, arguments, name="the engine", descriptors=[reading])
        finally:
            os.close(reading)
        return cls(child, PointerFeed(writing), ring)

    async def play(self, order: Order) -> None:
        """Play another order; returns once the run is ready. Raises ChildError."""
        self.child.write(order.as_json())
        await self.child.read()

    async def end(self) -> None:
        """End the process."""
        self.feed.close()
        await self.child.end()
        self.ring.unlink(missing_ok=True)


def _view_of(table: Table, before: View | None, resolution_hz: float, *, has_kernels: bool) -> View:
    """The view of a table; the bars of a view before it, of the same device, move on."""
    bar = LiveBar(table.device) if before is None else before.bar
    paper = PaperBar(table.device) if before is None else before.paper
    return View(table, bar, resolution_hz, paper=paper, has_kernels=has_kernels)


def _is_same(one: Table, other: Table) -> bool:
    """Whether two open tables are one: an early one is replaced by one with clicks."""
    return (one.path, one.fingerprint, len(one.clicks)) == (other.path, other.fingerprint, len(other.clicks))


class DemoBackend:
    """Plays one choice at a time. `cache` is the folder of tables, `work` that of the ring."""

    def __init__(self, choice: Choice, device: Device, offers: Offered, cache: Path, work: Path) -> None:
        self.scene_number = 0
        self.restarts = 0
        """Number of restarts of processes that ended by themselves."""
        self._choice, self._device, self._offers = choice, device, offers
        self._cache, self._work = cache, work
        self._builder = Builder(self._changed)
        self._pointers = Pointers()
        self._firmware: _Firmware | None = None
        self._engine: _Engine | None = None
        self._reader: RingReader | None = None
        self.view: View | None = None
        """The view of the browsers; None until the engine runs."""
        self._plays: tuple[Choice, bool] | None = None
        """The choice that plays, and whether kernels are compiled for it."""
        self._compared: dict[str, Any] | None = None
        """What a table that was built here is beside the shipped one."""
        self._table: Table | None = None
        self._is_between = False
        """Whether one run ends and the next begins."""
        self._boot: tuple[int, int] = (0, 0)
        self._rings = 0
        self._status, self._trouble = "starting", ""
        self._news = asyncio.Event()

    @property
    def process_ids(self) -> tuple[int, ...]:
        """Process ids of the emulated firmware and the engine, of those that run."""
        return tuple(part.child.process.pid for part in (self._firmware, self._engine) if part is not None)

    # ---- for the server -----------------------------------------------------------------------------------

    def scene(self) -> dict[str, Any]:
        """The part of the state that changes seldom, as JSON values."""
        building, table = self._builder.now, self._table
        return {
            "mode": "demo",
            "device": device_json(self._device if self.view is None or table is None else table.device),
            "devices": list(self._offers.devices),
            "rules": [rules.value for rules in self._offers.rules],
            "levels_db": [*self._device.levels_db, None],
            "choice": self._choice.as_json(),
            "status": self._status,
            "trouble": self._trouble,
            "restarts": self.restarts,
            "building": to_plain(building),
            "clicks": 0 if table is None else len(table.clicks),
            "plays": None if self._plays is None else self._plays[0].as_json(),
            "is_shipped": table is not None and table.is_shipped,
            "is_outdated": table is not None and is_outdated(table),
            "is_coarse": table is not None and "clicks_are_coarse" in table.attributes,
            "has_kernels": self._plays is not None and self._plays[1],
            "compared": self._compared,
        }

    def touch(self, browser: int, events: Sequence[PointerEvent]) -> None:
        """Take pointer events of a browser."""
        self._pointers.take(browser, events, time.monotonic_ns())

    def leave(self, browser: int) -> None:
        """Release the pointers of a browser that disconnected."""
        self._pointers.leave(browser)

    def choose(self, switches: dict[str, Any]) -> None:
        """Move switches; an invalid switch or position changes nothing and is shown as trouble."""
        try:
            choice = changed(self._choice, switches, self._device, self._offers)
            if choice.device != self._choice.device:
                self._device = find_device(choice.device)
                if choice.level_db not in (*self._device.levels_db, math.inf):
                    choice = replace(choice, level_db=self._device.levels_db[0])
            self._choice, self._trouble = choice, ""
            self._builder.forgive()
        except (ChoiceError, DeviceError) as error:
            self._trouble = str(error)
        self._changed()

    def sound(self, finger: int) -> bytes | None:
        """What a finger felt, as a SOUND message."""
        return None if self.view is None else self.view.sound(finger)

    def tick(self) -> tuple[list[bytes], bool]:
        """Advance the bar to the present, as the firmware drove it."""
        self._pointers.repeat(time.monotonic_ns())
        view, firmware, reader = self.view, self._firmware, self._reader
        if view is None or firmware is None or reader is None or self._is_between:
            return [], False
        messages = []
        for applied in firmware.ask():
            boot = (firmware.child.process.pid, applied.host_ns_at_device_zero)
            if boot != self._boot:
                self._boot, view.zero_ns = boot, applied.host_ns_at_device_zero
                view.begin(applied.until_us)
            view.read(reader.read())
            view.take(applied.events)
            messages += view.move(applied.until_us, is_loaded=self._choice.is_loaded)
        picture = view.picture()
        return [*messages, encode_picture(picture)], bool(picture.fingers) or view.is_moving

    def _changed(self) -> None:
        self.scene_number += 1
        self._news.set()

    # ---- processes ----------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Build, start, change and restart until cancelled."""
        back_off_s = SHORTEST_BACK_OFF_S
        try:
            while True:
                self._news.clear()
                try:
                    await self._follow()
                    back_off_s = SHORTEST_BACK_OFF_S
                except (ChildError, RingError, OSError) as error:
                    self._status, self._trouble = "restarting", str(error)
                    self.restarts += 1
                    self.scene_number += 1
                    await self._end_rig()
                    await asyncio.sleep(back_off_s)
                    back_off_s = min(2 * back_off_s, LONGEST_BACK_OFF_S)
                    continue
                await self._wait()
        finally:
            await self._builder.end()
            await self._end_rig()

    async def _wait(self) -> None:
        """Wait until a switch moved, a table became usable, or a process ended."""
        waits: list[asyncio.Task[Any]] = [asyncio.create_task(self._news.wait())]
        parts = [part for part in (self._firmware, self._engine) if part is not None]
        waits += [asyncio.create_task(part.child.process.wait()) for part in parts]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()

    async def _follow(self) -> None:
        """Make what plays equal to what is chosen. Raises ChildError, RingError, OSError."""
        for part, name in ((self._firmware, "the emulated firmware"), (self._engine, "the engine")):
            if part is not None and part.child.process.returncode is not None:
                raise ChildError(f"{name} {ending_text(part.child.process.returncode)}")
        choice, device = self._choice, self._device
        order = order_for(choice.device, device, self._cache)
        table = self._table
        has_all = table is not None and table.path == order.path and table.fingerprint == device.fingerprint
        if has_all and self._builder.has_compiled:
            self._builder.stop()
        elif not has_all:
            had_built = self._builder.has_built(order)
            table = await asyncio.to_thread(open_cached, device, order.path)
            if (table is None or table.path != order.path) and self._builder.has_built(order) and not had_built:
                self._news.set()  # the table was finished during the look: look again
            if table is None:
                self._builder.ask(order)
                self._status = "building" if self.view is None else self._status
                return
            if self._table is not None and self._table is not table and _is_same(table, self._table):
                table.close()
                table = self._table
        assert table is not None
        wanted = replace(choice, is_loaded=True), self._builder.has_compiled
        if table is not self._table or wanted != self._plays:
            await self._change_over(choice, device, table)
        if table.path != order.path or not self._builder.has_compiled:
            self._builder.ask(order)  # only now: what there is plays first

    async def _change_over(self, choice: Choice, device: Device, table: Table) -> None:
        if self._firmware is None or self.view is None or self.view.table.fingerprint != table.fingerprint:
            if self._firmware is not None:
                await self._end_rig()
            self._firmware = await _Firmware.start(device)
        if self._engine is None:
            self._rings += 1
            self._engine = await _Engine.start(self._work / f"ring-{os.getpid()}-{self._rings}")
        has_kernels = self._builder.has_compiled
        played = None if self._plays is None else self._plays[0].source
        hand = hand_of(choice)
        order = Order(table.path, self._firmware.port, choice, self._offers.rule_file, has_kernels)
        resolution_hz = configuration_of(device).frequency_resolution_uhz * 1e-6
        before = self.view
        if before is not None and hand is not None and played is Source.HAND and table is self._table:
            view = before  # another drive by hand, as the sliders move
        else:
            view = await asyncio.to_thread(_view_of, table, before, resolution_hz, has_kernels=has_kernels)
        if before is None:
            self._boot = (0, 0)
        else:
            view.zero_ns = before.zero_ns
        # What the next run does from its first moment on is for the next view: the one before reads no more.
        self._is_between = True
        try:
            await self._engine.play(order)
        finally:
            self._is_between = False
        if self._reader is None:
            self._reader = RingReader(self._engine.ring, from_start=True)
        shown = self._table
        self.view, self._table, self._plays = view, table, (replace(choice, is_loaded=True), has_kernels)
        await self._compare(device, shown, table)
        if shown is not None and shown is not table:
            shown.close()
        if hand is not None:
            view.play_by_hand(hand)
        self._pointers.feed(self._engine.feed if hand is None else None)
        self._status, self._trouble = "running", ""
        self.scene_number += 1

    async def _compare(self, device: Device, before: Table | None, table: Table) -> None:
        """Compare a table with coarse clicks that was built here with the shipped one, once it took its place."""
        if before is None or not before.is_shipped or before.fingerprint != table.fingerprint or table.is_shipped:
            return
        found = await asyncio.to_thread(compare_with_shipped, before, table)
        self._compared = {"device": device.name, **found.as_json()}

    async def _end_rig(self) -> None:
        self._pointers.feed(None)
        if self._reader is not None:
            self._reader.close()
        engine, firmware = self._engine, self._firmware
        self._engine = self._firmware = self._reader = self.view = self._plays = None
        if engine is not None:
            await engine.end()
        if firmware is not None:
            await firmware.end()
