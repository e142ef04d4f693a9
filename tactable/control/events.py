"""Records of the ring to events for programs: which finger touches where, and what was played with its promise.

The promise of a click is that of the table, above the named threshold: what 95 % of the sampled plants give the weakest
felt finger at least, and the strongest quiet one at most. A steady drive, and a click of more fingers than the table
holds, is solved in the run, so nothing is promised here. Their promise is None.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from engine.loop import Record
from engine.table import Table
from engine.touch import Touch

MATCHED_M = 4e-3
"""A finger is the one of a placement if it touches within this distance of it."""
RegionAt = Callable[[float, int | None], str | None]


class Events:
    """Events of one run; `table` is replaced as the run's is. `region_at` names the region of a position and a zone."""

    def __init__(self, table: Table, region_at: RegionAt) -> None:
        self.table = table
        self._region_at = region_at
        self._touches: tuple[Touch, ...] = ()

    def read(self, records: Iterable[Record]) -> Iterator[dict[str, Any]]:
        """The events of new records, in order."""
        for record in records:
            if record.touches != self._touches:
                self._touches = record.touches
                yield {"event": "touches", "time_ns": record.time_ns, "fingers": self.fingers()}
            if record.drive_sequence is not None:  # a command was written
                yield self._played(record)

    def fingers(self) -> list[dict[str, Any]]:
        """The fingers that touch now, each with its region."""
        zones = self.table.device.zones
        return [
            {
                "finger": finger,
                "at_m": at_m,
                "zone": None if zone is None else zones[zone].name,
                "region": self._region_at(at_m, zone),
            }
            for finger, at_m, zone in self._touches
        ]

    def _played(self, record: Record) -> dict[str, Any]:
        placement, level_db = record.placement, record.level_db
        is_silence = placement is None or level_db is None
        event = {
            "event": "played",
            "time_ns": record.time_ns,
            "kind": "silence" if is_silence else "click" if record.is_click else "drive",
            "level_db": None if level_db is None or math.isinf(level_db) else level_db,
            "is_full_scale": level_db is not None and math.isinf(level_db),
            "is_provisional": record.is_provisional,
            "sequence": record.drive_sequence,
            "fingers": [],
            "promise": None,
        }
        if placement is None or level_db is None:
            return event
        event["fingers"] = [
            {"finger": self._finger_at(at_m), "at_m": at_m, "role": "felt" if is_felt else "quiet"}
            for at_m, is_felt in zip(placement.position_m, placement.is_felt, strict=True)
        ]
        click = self.table.click_at(placement, level_db) if record.is_click and not record.is_provisional else None
        if click is not None:
            event["promise"] = {
                "felt_at_least_db": click.felt.low_db,
                "quiet_at_most_db": None if click.quiet is None else click.quiet.high_db,
                "share_of_plants": 0.95,
                "is_achieved": bool(click.achieved),
            }
        return event

    def _finger_at(self, at_m: float) -> int | None:
        near = [(abs(touch.position_m - at_m), touch.contact_id) for touch in self._touches]
        distance_m, finger = min(near, default=(math.inf, None))
        return finger if distance_m <= MATCHED_M else None
