"""The backend of a live run: reads the ring, and simulates the bar as the commands would move it.

It only looks on, unless it was given a way to `ask`: then browsers may drive the board by hand
(tactable.page.asked_by_hand).
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from engine.loop import RingReader
from engine.render import RendererError
from engine.table import Table, TableError
from engine.touch.sources.pointer import PointerEvent
from tactable.page.hand import Channels, HandDrive, HandError, first_channels, read_channels
from tactable.page.live_bar import LiveBar
from tactable.page.messages import DroppedFile, encode_picture
from tactable.page.ring_drive import RingDrive
from tactable.page.scene import device_json
from tactable.page.view import View
from tactable.run.table_watch import LOOK_S, identity_of

BEHIND_NS = 30_000_000
"""Age of the picture; ring records are written after their command."""
_NS_PER_US = 1000


class LiveBackend:
    """Shows one run; a new table at the same path is adopted, as the run adopts it."""

    def __init__(
        self,
        reader: RingReader,
        table_path: Path,
        frequency_resolution_hz: float,
        full_scales_m: Sequence[float],
        ask: Callable[[Channels | None], None] | None = None,
    ) -> None:
        self.scene_number = 0
        self._ask = ask
        self._hand: Channels | None = None
        """What was asked for last; None: fingers decide."""
        self._is_driving = False
        """Whether the run said that the board plays that."""
        self._trouble = ""
        self._reader, self._table_path, self._resolution_hz = reader, table_path, frequency_resolution_hz
        self._full_scales_m = tuple(full_scales_m)
        self._identity = identity_of(table_path)
        self._take_up(Table.open(table_path, verify=False))

    def _take_up(self, table: Table) -> None:
        self._is_driving, self._hand = False, None
        self._drive = RingDrive(table, self._resolution_hz, self._full_scales_m)
        self._table = table
        self._view = View(table, LiveBar(table.device), self._resolution_hz, halvings=self._drive.halvings)
        self.scene_number += 1

    def scene(self) -> dict[str, Any]:
        """The part of the state that changes seldom, as JSON values."""
        return {
            "mode": "live",
            "device": device_json(self._table.device),
            "status": "running",
            "trouble": self._trouble,
            "restarts": 0,
            "building": None,
            "clicks": len(self._table.clicks),
            "plays": {"source": "hand"} if self._is_driving else {},
            "choice": {} if self._hand is None else {"source": "hand", "hand": self._hand},
            "drives": self._ask is not None,
        }

    def tick(self) -> tuple[list[bytes], bool]:
        """Read the ring and advance the bar."""
        self._catch_up()
        view = self._view
        messages = view.move((time.monotonic_ns() - BEHIND_NS) / _NS_PER_US, is_loaded=True)
        picture = view.picture()
        return [*messages, encode_picture(picture)], bool(picture.fingers) or view.is_moving

    def _catch_up(self) -> None:
        records = list(self._reader.read())
        self._view.read(records)
        self._view.take(self._drive.events(records))

    def touch(self, browser: int, events: Sequence[PointerEvent]) -> None:
        """Ignored: the fingers are those of a digitizer."""

    def leave(self, browser: int) -> None:
        """Nothing to release: browsers have no pointers here."""

    def choose(self, switches: dict[str, Any]) -> None:
        """Ask for a drive by hand, once more for the same one, or for its end; a run has no other switches.

        The first drive is silent, since a real board plays it. One beyond the limits of the device changes nothing.
        """
        if self._ask is None:
            return
        before, device = self._hand, self._table.device
        try:
            if switches.get("source") == "hand":
                self._hand = tuple((hz, 0.0, degrees) for hz, _, degrees in first_channels(device))
            elif "source" in switches:
                self._hand = None
            elif "hand" in switches and self._hand is not None:
                self._hand = read_channels(switches["hand"], device)
        except HandError as error:
            self._trouble = str(error)
            self.scene_number += 1
            return
        self._ask(self._hand)
        if self._hand != before:  # a drive that is repeated leaves what was told of another one
            self._trouble = ""
            self._show()

    def hear(self, *, is_driving: bool) -> None:
        """Take what the run says: the board plays what was asked for, or fingers decide again."""
        if not is_driving:
            self._hand = None
        self._is_driving = is_driving
        self._show()

    def _show(self) -> None:
        """Let the bar of the page move as the board does now."""
        self.scene_number += 1
        now_us = time.monotonic_ns() // _NS_PER_US
        if self._is_driving and self._hand is not None:
            hand = HandDrive(self._hand)
            self._catch_up()  # with how the run of the touches ended, which is no end of this drive
            self._view.take([self._drive.by_hand(hand, now_us)])
            self._view.play_by_hand(hand)
        elif self._view.is_by_hand:
            self._view.take([self._drive.by_hand(None, now_us)])
            self._view.end_by_hand()

    def drop(self, file: DroppedFile) -> None:
        """Ignored: a run has one device."""

    def sound(self, finger: int) -> bytes | None:
        """What a finger felt, as a SOUND message."""
        return self._view.sound(finger)

    async def run(self) -> None:
        """Watch for another table until cancelled."""
        while True:
            await asyncio.sleep(LOOK_S)
            with contextlib.suppress(
                OSError, TableError, RendererError
            ):  # being replaced, or not usable: the run ignores it too
                found = identity_of(self._table_path)
                if found != self._identity:
                    self._identity = found
                    table = await asyncio.to_thread(Table.open, self._table_path)
                    before = self._table
                    self._take_up(table)
                    before.close()
