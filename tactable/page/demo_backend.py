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
import re
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from base.child import ChildError, ending_text
from base.plain import to_plain
from engine.device import Device, DeviceError
from engine.loop.ring import RingError
from engine.table import Table, TableError
from engine.touch.sources.pointer import PointerEvent
from tactable.page.choices import Choice, ChoiceError, Offered, changed, moved, of_device
from tactable.page.live_bar import LiveBar, PaperBar
from tactable.page.page_messages import DroppedFile, encode_picture
from tactable.page.page_server import PageBackend
from tactable.page.pointers import Pointers
from tactable.page.processes.asynchronous import Builder, EngineProcess, FirmwareProcess, order_for
from tactable.page.processes.build_process import BuildOrder
from tactable.page.processes.engine_process import Order, ProgramsAt
from tactable.page.view import View, device_json
from tactable.rig.emulate import configuration_of
from tactable.rig.promises import OtherBar, SampledPromises
from tactable.rig.ready import (
    cached_table,
    compare_with_shipped,
    early_path,
    is_first,
    is_outdated,
    open_cached,
    open_first_table,
)
from tactable.shipped import find_device

SHORTEST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.25, 5.0  # one crash is made good at once; one that repeats costs little
_UNSAFE = re.compile(r"[^\w.-]+")
_LONGEST_NAME = 64  # of a file that was dropped; its end, which tells more


def _view_of(table: Table, before: View | None, resolution_hz: float) -> View:
    """The view of a table; the bars of a view before it move on where they are of the same device.

    A table without rows of a sweep, which is one of modes alone or of a bar with one actuator, has no second bar.
    """
    if before is None or before.table.fingerprint != table.fingerprint:
        bar = LiveBar(table.device)
        paper = PaperBar(bar, table.best_rows)
    else:
        bar, paper = before.bar, before.paper or PaperBar(before.bar, table.best_rows)
        paper.rows = table.best_rows
        if before.paper is None:
            paper.begin_at_rest(bar.now_us)
    view = View(table, bar, resolution_hz, paper=paper if table.best_rows else None)
    if before is not None and before.table is table:
        view.spreads = before.spreads
    return view


def _played(choice: Choice) -> Choice:
    """The choice without what is of the simulated bar alone."""
    return replace(choice, is_loaded=True, is_other=False)


def _identity(table: Table) -> tuple[Path, str, int]:
    """What open tables that are one have in common: an early one is replaced by one with clicks."""
    return table.path, table.fingerprint, len(table.clicks)


class DemoBackend(PageBackend):
    """Plays one choice at a time. `cache` is the folder of tables, `work` that of the ring and of what goes with it.

    `programs` says where the control channel is; None: there is no channel. `say` prints a line.
    """

    def __init__(
        self,
        choice: Choice,
        device: Device,
        offers: Offered,
        cache: Path,
        work: Path,
        programs: ProgramsAt | None = None,
        say: Callable[[str], None] = print,
    ) -> None:
        self.restarts = 0  # number of restarts of processes that ended by themselves
        self._choice, self._offers = choice, offers
        self._described = device  # the device as its file has it
        self._device = moved(device, choice)  # the device that is to play: its actuators may have been moved
        self._cache, self._work = cache, work
        self._programs, self._say = programs, say
        self._builder = Builder(self._changed)
        self._pointers = Pointers()
        self._firmware: FirmwareProcess | None = None
        self._engine: EngineProcess | None = None
        self.view: View | None = None  # the view of the browsers; None until the engine runs
        self._plays: tuple[Choice, bool] | None = None  # the choice that plays, and whether kernels are compiled for it
        self._compared: dict[str, Any] | None = None  # what a table that was built here is beside the shipped one
        self._table: Table | None = None
        self._is_outdated = False  # whether older code made the shipped table that plays
        self._is_between = False  # whether one run ends and the next begins
        self._other: OtherBar | None = None
        self._shown_solved = 0  # how many solved clicks the browsers have heard of
        self._status, self._trouble = "starting", ""
        self._news = asyncio.Event()

    # ---- for the server -----------------------------------------------------------------------------------

    def scene(self) -> dict[str, Any]:
        """The part of the state that changes seldom, as JSON values."""
        building, table = self._builder.now, self._table
        return {
            "mode": "demo",
            "device": device_json(self._device if self.view is None or table is None else table.device),
            "devices": list(self._offers.devices),
            "rules": [rules.value for rules in self._offers.rules],
            "levels_db": [*self._described.levels_db, None],
            "choice": to_plain(self._choice),
            "status": self._status,
            "trouble": self._trouble,
            "restarts": self.restarts,
            "building": to_plain(building),
            "clicks": 0 if table is None else len(table.clicks),
            "plays": None if self._plays is None else to_plain(self._plays[0]),
            "is_shipped": table is not None and table.is_shipped,
            "is_outdated": self._is_outdated,
            "is_early": table is not None and table.path == early_path(cached_table(table.device, self._cache)),
            "has_kernels": self._plays is not None and self._plays[1],
            "compared": self._compared,
            "what_if": self._what_if(),
            "other": None if self._other is None else str(self._other),
            "solved": self._solved(),
        }

    def _solved(self) -> dict[str, Any] | None:
        """How many clicks were solved for fingers, and where those of the last one are; None where a table has them."""
        if self.view is None or not self.view.table.clicks or not is_first(self.view.table):
            return None
        placements = self.view.solved
        return {"count": len(placements), "last_m": to_plain(placements[-1].position_m) if placements else ()}

    def _what_if(self) -> dict[str, Any] | None:
        """The actuators that were moved, where the file has them, and the device file with their places."""
        if self._device.fingerprint == self._described.fingerprint:
            return None
        pairs = zip(self._device.actuators, self._described.actuators, strict=True)
        places = [(now.name, now.position_m, was.position_m) for now, was in pairs if now.position_m != was.position_m]
        return {
            "moved": [
                {"name": name, "position_m": to_plain(at_m), "file_m": to_plain(file_m)}
                for name, at_m, file_m in places
            ],
            "text": self._device.text,
        }

    def touch(self, browser: int, events: Sequence[PointerEvent]) -> None:
        """Take pointer events of a browser."""
        self._pointers.take_events(browser, events, time.monotonic_ns())

    def leave(self, browser: int) -> None:
        """Release the pointers of a browser that disconnected."""
        self._pointers.leave(browser)

    def choose(self, switches: dict[str, Any]) -> None:
        """Move switches; an invalid switch or position changes nothing and is shown as trouble."""
        try:
            choice = changed(self._choice, switches, self._described, self._offers)
            is_other = choice.device != self._choice.device
            self._take(choice, find_device(choice.device) if is_other else self._described)
        except (ChoiceError, DeviceError) as error:
            self._trouble = str(error)
        self._changed()

    def drop(self, file: DroppedFile) -> None:
        """Play the device of a file that was dropped on the page; what is wrong with it is shown as trouble."""
        file_name = _UNSAFE.sub("-", Path(file.name).name)[-_LONGEST_NAME:].removesuffix(".toml") + ".toml"
        try:
            described = Device.parse(file.text, file_name)
            path = self._work / "dropped" / described.fingerprint[:12] / file_name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(file.text, encoding="utf-8")
            self._take(of_device(self._choice, str(path)), described)
            others = (each for each in self._offers.devices if Path(each).name != file_name)
            self._offers = replace(self._offers, devices=(*others, str(path)))
        except (DeviceError, OSError) as error:
            self._trouble = str(error)
        self._changed()

    def _take(self, choice: Choice, described: Device) -> None:
        """Take a choice for a device as its file has it. Raises DeviceError for places that its bar does not have."""
        if choice.level_db not in (*described.levels_db, math.inf):
            choice = replace(choice, level_db=described.levels_db[0])
        self._device = moved(described, choice)
        self._choice, self._described, self._trouble = choice, described, ""
        if not choice.is_other:
            self._other = None
        elif self._other is None or self._other.nominal.fingerprint != self._device.fingerprint:
            self._other = OtherBar(self._device, secrets.randbits(32))  # each one is new
        self._builder.forgive()

    def sound(self, finger: int) -> bytes | None:
        """Vibration that a finger felt, as a SOUND message."""
        return None if self.view is None else self.view.sound(finger)

    def tick(self) -> tuple[list[bytes], bool]:
        """Advance the bar to the present, as the firmware drove it."""
        self._pointers.bring_down(time.monotonic_ns())
        view, firmware, engine = self.view, self._firmware, self._engine
        if view is None or firmware is None or engine is None or self._is_between:
            return [], False
        other = self._other
        if other is not None and other.nominal.fingerprint != view.bar.device.fingerprint:
            other = None  # the run of the device before has not ended yet
        messages = []
        for applied in firmware.take_answers():
            if applied.host_ns_at_device_zero != view.zero_ns:  # it has booted
                view.zero_ns = applied.host_ns_at_device_zero
                view.begin_at_rest(applied.until_us)
            view.read(engine.records())
            view.take_events(applied.events)
            messages += view.move(applied.until_us, is_loaded=self._choice.is_loaded, other=other)
        if len(view.solved) != self._shown_solved:
            self._shown_solved = len(view.solved)
            self.scene_number += 1
        picture = view.picture()
        return [*messages, encode_picture(picture)], bool(picture.fingers) or view.ours.is_moving

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
                except (ChildError, RingError, TableError, OSError) as error:
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
        order = order_for(choice.device, self._described, self._cache, self._work)
        table = await self._best_table(device, order)
        wanted = _played(choice), self._builder.has_compiled
        if table is not self._table or wanted != self._plays:
            await self._change_over(choice, device, table)
        # For actuators that were moved kernels are compiled, and no table is built.
        is_built = table.path == order.path or bool(choice.actuators_m)
        if not is_built or not self._builder.has_compiled:
            self._builder.order_build(order)  # only now: the table that is already there plays first
        elif table.path == order.path:
            self._builder.stop()
        view = self.view
        if view is not None and self._builder.has_compiled and table.clicks and view.spreads is None:
            with contextlib.suppress(TableError):  # clicks of options that are not known here
                view.spreads = await asyncio.to_thread(SampledPromises, table)
        if table.is_shipped:
            self._is_outdated = await asyncio.to_thread(is_outdated, table)
            self.scene_number += 1

    async def _best_table(self, device: Device, order: BuildOrder) -> Table:
        """The best table of a device that there is: built here, shipped, or made in a moment. Raises TableError."""
        path, shown = cached_table(device, self._cache), self._table
        if shown is not None and shown.path == path and shown.fingerprint == device.fingerprint:
            return shown
        had_built = order in self._builder.built
        table = await asyncio.to_thread(open_cached, device, path)
        if (table is None or table.path != order.path) and order in self._builder.built and not had_built:
            self._news.set()  # the table was finished during the look: look again
        if table is None:
            is_built = device.fingerprint == self._described.fingerprint
            return await self._first_table(device, order.first if is_built else None)
        if shown is not None and _identity(table) == _identity(shown):
            table.close()
            return shown
        return table

    async def _first_table(self, device: Device, with_click: Path | None) -> Table:
        """The table of a device that has no other: with a click once one is solved, until then of modes alone.

        with_click: where the builder puts the one with a click; None: it makes none, for actuators that were moved, and
        the click is solved here once kernels are compiled.
        """
        has_kernels = self._builder.has_compiled  # they make the rows of its sweep, too
        shown = self._table
        bare = self._work / f"first-{device.fingerprint[:12]}{'-swept' * has_kernels}.nc"
        is_solved = with_click is not None and with_click.is_file()
        path = with_click if with_click is not None and is_solved else bare
        if shown is not None and shown.path == path and path.is_file():
            return shown
        if is_solved:
            return await asyncio.to_thread(Table.open, path, device=device, verify=False)
        has_click = has_kernels and with_click is None
        return await asyncio.to_thread(open_first_table, device, bare, has_rows=has_kernels, has_click=has_click)

    async def _change_over(self, choice: Choice, device: Device, table: Table) -> None:
        configuration = configuration_of(device)
        if self._firmware is None or self._firmware.configuration != configuration:
            if self._firmware is not None:
                await self._end_rig()
            self._firmware = await FirmwareProcess.start(configuration)
        if self._engine is None:
            ring = self._work / f"ring-{secrets.token_hex(8)}"
            self._engine = await EngineProcess.start(ring, self._programs)
        has_kernels = self._builder.has_compiled
        port, rule_file = self._firmware.port, self._offers.rule_file
        order = Order(table.path, port, choice, rule_file, has_kernels, is_first(table))
        resolution_hz = configuration.frequency_resolution_uhz * 1e-6
        before = self.view
        view = await asyncio.to_thread(_view_of, table, before, resolution_hz)
        if before is not None:
            view.zero_ns = before.zero_ns
        # What the next run does from its first moment on is for the next view: the one before reads no more.
        self._is_between = True
        self._pointers.feed(None)
        try:
            lines = await self._engine.play(order)
        finally:
            self._is_between = False
        if before is not None and view.bar is not before.bar:
            view.begin_at_rest(before.bar.now_us)
        for line in lines:
            self._say(line)
        shown = self._table
        self.view, self._table, self._plays = view, table, (_played(choice), has_kernels)
        self._pointers.feed(self._engine.feed)
        await self._compare(device, shown, table)
        if shown is not None and shown is not table:
            shown.close()
            if is_first(shown):
                shown.path.unlink(missing_ok=True)
        self._status, self._trouble = "running", ""
        self.scene_number += 1

    async def _compare(self, device: Device, before: Table | None, table: Table) -> None:
        """Compare a table with few places that was built here with the shipped one, once it took its place."""
        if before is None or not before.is_shipped or before.fingerprint != table.fingerprint or table.is_shipped:
            return
        found = await asyncio.to_thread(compare_with_shipped, before, table)
        self._compared = {"device": device.name, **found.as_json()}

    async def _end_rig(self) -> None:
        self._pointers.feed(None)
        engine, firmware = self._engine, self._firmware
        self._engine = self._firmware = self.view = self._plays = None
        if engine is not None:
            await engine.end()
        if firmware is not None:
            await firmware.end()
