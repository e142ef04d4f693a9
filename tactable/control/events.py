"""Records of the ring to events for programs: which finger touches where, and what was played with its promise.

A promise is what the table says of the levels of the weakest felt and the strongest quiet finger, with their spread:

- A **click** of the table has its promise there, over sampled bars and fingers.
- A **steady drive** is what the device was sent, so its levels are computed from these bytes and the modes of the
  table, over sampled fingers (engine.steady.steady_drive).
- A click that was solved beside the run has none: its spread would take a second.

It is computed when its record is read, in the process of the control channel. Of several steady drives that are read
at once, as when a finger drags, only the last has one: that bounds what promises cost.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from base.arrays import Array
from base.points import json_of
from engine.loop.ring import Record
from engine.render.board_fit import RendererError, scales_for
from engine.steady.steady_drive import CASES, compute_levels
from engine.table import ClickEntry, Table
from engine.touch import Placement, Touch
from firmware_link.protocol.drive_words import decode_drive

MATCHED_M = 4e-3  # a finger is the one of a placement if it touches within this distance of it
RegionAt = Callable[[complex, int | None], str | None]
SHARE = 0.95  # of the sampled plants: felt fingers reach, and quiet ones keep to, what is promised
_PERCENTS = (5, 50, 95)  # as precompute/predict/at_positions.py
_REACHED_DB = 0.05  # the wire rounds amplitude and frequency: a level this close to the wanted one is reached


@dataclass(frozen=True)
class Board:
    """What the numbers of a SET mean on the connected board; full_scales_m by actuator."""

    frequency_resolution_hz: float
    full_scales_m: tuple[float, ...]


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


def promise_of(table: Table, record: Record, board: Board | None) -> dict[str, Any] | None:
    """What an event says of the levels that a command promises; None where they cannot be computed in time."""
    placement, level_db = record.placement, record.level_db
    if placement is None or level_db is None:
        return None
    if record.drive:
        return None if board is None else _of_drive(table, record.drive, board, placement, level_db)
    click = table.click_at(placement, level_db) if record.is_click else None
    return None if click is None else _of_click(table, click)


def _of_click(table: Table, click: ClickEntry) -> dict[str, Any]:
    felt, quiet = (
        spread and _levels(spread.nominal_db, spread.low_db, spread.middle_db, spread.high_db)
        for spread in (click.felt, click.quiet)
    )
    return _promise(table, felt, quiet, click.achieved, "sampled bars and fingers")


def _of_drive(table: Table, drive: bytes, board: Board, placement: Placement, level_db: float) -> dict[str, Any]:
    device = table.device
    scales = scales_for(device, board.full_scales_m)
    channels = decode_drive(drive, board.frequency_resolution_hz)[: len(scales)]
    amplitude = np.array(
        [c.amplitude / scale * np.exp(1j * c.phase_rad) for c, scale in zip(channels, scales, strict=True)]
    )
    hz = [channel.frequency_hz for channel in channels]
    found_db = compute_levels(device, table.modes, placement.position_m, hz, amplitude)
    is_felt = np.array(placement.is_felt)
    weakest = found_db[:, is_felt].min(axis=1)
    quiet = None if is_felt.all() else _over_cases(found_db[:, ~is_felt].max(axis=1))
    is_achieved = math.isinf(level_db) or float(weakest[0]) >= level_db - _REACHED_DB
    return _promise(table, _over_cases(weakest), quiet, is_achieved, f"{CASES} cases of sampled fingers")


def _over_cases(level_db: Array) -> dict[str, float]:
    """Levels (case,), the standard case first."""
    return _levels(float(level_db[0]), *np.percentile(level_db[1:], _PERCENTS).tolist())


def _levels(nominal_db: float | None, low_db: float, middle_db: float, high_db: float) -> dict[str, Any]:
    return {"nominal": nominal_db, "5 %": low_db, "50 %": middle_db, "95 %": high_db}


def _promise(table: Table, felt: Any, quiet: Any, is_achieved: bool, over: str) -> dict[str, Any]:
    return {
        "felt_at_least_db": felt["5 %"],
        "quiet_at_most_db": quiet and quiet["95 %"],
        "share_of_plants": SHARE,
        "is_achieved": bool(is_achieved),
        "felt_db": felt,
        "quiet_db": quiet,
        "over": over,
        "threshold": table.device.threshold.title,
    }
