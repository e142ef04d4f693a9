"""The backend of a live run: reads the ring, and simulates the bar as the commands would move it. It only looks on."""

import asyncio
import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from base.files import identity_of
from engine.loop.ring import RingReader
from engine.render.link_commands import RendererError
from engine.table import Table, TableError
from tactable.page.live_bar import LiveBar
from tactable.page.page_messages import encode_picture
from tactable.page.page_server import PageBackend
from tactable.page.ring_drive import RingDrive
from tactable.page.view import View, device_json
from tactable.rig.promises import SampledPromises
from tactable.run.table_watch import LOOK_S
from tactable.run.track_status import read_status, track_text

BEHIND_NS = 30_000_000  # age of the picture; ring records are written after their command
_NS_PER_US = 1000


class LiveBackend(PageBackend):
    """Shows one run; a new table at the same path is adopted, as the run adopts it."""

    def __init__(
        self,
        reader: RingReader,
        table_path: Path,
        frequency_resolution_hz: float,
        full_scales_m: Sequence[float],
    ) -> None:
        self._reader, self._table_path, self._resolution_hz = reader, table_path, frequency_resolution_hz
        self._full_scales_m = tuple(full_scales_m)
        self._identity, self._tracked = identity_of(table_path), ""
        self._take_up(Table.open(table_path, verify=False))

    def _take_up(self, table: Table) -> None:
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
            "trouble": "",
            "restarts": 0,
            "building": None,
            "clicks": len(self._table.clicks),
            "plays": {},
            "choice": {},
            "tracked": self._tracked,
        }

    def tick(self) -> tuple[list[bytes], bool]:
        """Read the ring and advance the bar."""
        records, view = list(self._reader.read()), self._view
        view.read(records)
        view.take_events(self._drive.events(records))
        messages = view.move((time.monotonic_ns() - BEHIND_NS) / _NS_PER_US, is_loaded=True)
        picture = view.picture()
        return [*messages, encode_picture(picture)], bool(picture.fingers) or view.is_moving

    def sound(self, finger: int) -> bytes | None:
        """Vibration that a finger felt, as a SOUND message."""
        return self._view.sound(finger)

    async def run(self) -> None:
        """Watch for another table until cancelled."""
        while True:
            with contextlib.suppress(TableError):  # clicks of options that are not known here
                if self._view.spreads is None and self._table.clicks:
                    self._view.spreads = await asyncio.to_thread(SampledPromises, self._table)
            await asyncio.sleep(LOOK_S)
            if (tracked := track_text(read_status(self._table_path))) != self._tracked:
                self._tracked = tracked
                self.scene_number += 1
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
