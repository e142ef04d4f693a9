"""Records of the ring to events for programs: which finger touches where, and what was played with its promise.

A promise is computed when its record is read (tactable.control.promise). Of several steady drives that are read at
once, as when a finger drags, only the last has one: that bounds what promises cost.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from base.points import json_of
from engine.loop.ring import Record
from engine.render.board_fit import scales_for
from engine.render.link_commands import RendererError
from engine.table import Table
from engine.touch import Touch
from firmware_link.protocol.messages import decode_drive
from tactable.control.promise import Board, promise_of

MATCHED_M = 4e-3  # a finger is the one of a placement if it touches within this distance of it
RegionAt = Callable[[complex, int | None], str | None]


class Events:
    """Events of one run of a table. `region_at` names the region of a position and a zone."""

    def __init__(self, table: Table, region_at: RegionAt) -> None:
        self.table = table
        self.board: Board | None = None  # the connected board, as which the bytes of drives are read
        self._region_at = region_at
        self._touches: tuple[Touch, ...] = ()

    def adopt(self, table: Table) -> bool:
        """Take another table, as the run does; False for one that the run refuses."""
        if [zone.name for zone in table.device.zones] != [zone.name for zone in self.table.device.zones]:
            return False
        if self.board is not None:
            try:
                scales_for(table.device, self.board.full_scales_m)
            except RendererError:
                return False
        self.table = table
        return True

    def read(self, records: Iterable[Record], *, has_promises: bool) -> Iterator[dict[str, Any]]:
        """The events of new records, in order, those of commands with their promises where `has_promises`."""
        found = list(records)
        is_drive = [record.drive_sequence is not None and bool(record.drive) for record in found]
        last_drive = max((index for index, each in enumerate(is_drive) if each), default=None)
        for index, record in enumerate(found):
            if record.touches != self._touches:
                self._touches = record.touches
                yield {"event": "touches", "time_ns": record.time_ns, "fingers": self.fingers()}
            if record.drive_sequence is not None:  # a command was written
                is_promised = has_promises and (not is_drive[index] or index == last_drive)
                promise = promise_of(self.table, record, self.board) if is_promised else None
                yield {**self._played(record), "promise": promise}

    def fingers(self) -> list[dict[str, Any]]:
        """The fingers that touch now, each with its region."""
        zones = self.table.device.zones
        return [
            {
                "finger": finger,
                "at_m": json_of(at_m),
                "zone": None if zone is None else zones[zone].name,
                "region": self._region_at(at_m, zone),
            }
            for finger, at_m, zone, _ in self._touches
        ]

    def _played(self, record: Record) -> dict[str, Any]:
        placement, level_db = record.placement, record.level_db
        is_silence = placement is None or level_db is None
        event = {
            "event": "played",
            "time_ns": record.time_ns,
            "kind": "silence" if is_silence else "click" if record.is_click else "drive",
            "effect": record.effect or None,
            "level_db": None if level_db is None or math.isinf(level_db) else level_db,
            "threshold": self.table.device.threshold.title,
            "frequencies_hz": self._frequencies_hz(record.drive),
            "is_full_scale": level_db is not None and math.isinf(level_db),
            "sequence": record.drive_sequence,
            "fingers": [],
        }
        if placement is None or level_db is None:
            return event
        event["fingers"] = [
            {"finger": self._finger_at(at_m), "at_m": json_of(at_m), "role": "felt" if is_felt else "quiet"}
            for at_m, is_felt in zip(placement.position_m, placement.is_felt, strict=True)
        ]
        return event

    def _frequencies_hz(self, drive: bytes) -> list[float]:
        """The frequencies of a steady drive, each once; none of a click and of silence."""
        channels = decode_drive(drive, self.board.frequency_resolution_hz) if drive and self.board else ()
        return sorted({channel.frequency_hz for channel in channels if channel.amplitude})

    def _finger_at(self, at_m: complex) -> int | None:
        near = [(abs(touch.position_m - at_m), touch.contact_id) for touch in self._touches]
        distance_m, finger = min(near, default=(math.inf, None))
        return finger if distance_m <= MATCHED_M else None
