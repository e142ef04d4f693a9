"""Records of a ring as a run of a table would leave them, and the firmware's events that they stand for."""

from collections.abc import Iterable

from engine.loop.ring import Record, RingCounters
from engine.render.limits import clamp
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement, Touch
from engine.touch.finger_tracker import ZoneFinder
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.protocol.drive_words import encode_drive
from tactable.page.live_bar import LiveBar
from tactable.page.processes.live_process import RingDrive

RESOLUTION_HZ = 0.01
STAGE_NS = 10_000
COUNTERS = RingCounters(1, 2, 3, 4, 5, 6)
FRAME_US = 16_667.0
LEVEL_DB = DEFAULT_LEVEL_DB


def touches_of(table: Table, placement: Placement) -> tuple[Touch, ...]:
    """A touch for every finger, numbered from 1."""
    edges = ZoneFinder(table.device)
    fingers = enumerate(placement.position_m, start=1)
    return tuple(Touch(number, at_m, edges.zone_at(at_m)) for number, at_m in fingers)


def record_of(
    table: Table,
    placement: Placement,
    at_ns: int,
    *,
    is_click: bool = False,
    is_unsolved: bool = False,
    is_sent: bool = True,
    level_db: float | None = LEVEL_DB,
) -> Record:
    """A report that brought these fingers, and what was written for them 50 us later.

    is_unsolved: a steady drive is in place of a click, which nobody solves.
    """
    drive = b""
    if level_db is not None and (not is_click or is_unsolved):
        solved = table.drive_for(
            [placement.position_m[finger] for finger in placement.felt],
            [placement.position_m[finger] for finger in placement.quiet],
            level_db,
        )
        drive = encode_drive(clamp(solved, table.device).channels, RESOLUTION_HZ)
    stamps = tuple(at_ns + STAGE_NS * stage for stage in range(6)) if is_sent else (0, at_ns, 0, 0, 0, 0)
    a, b, c, d, e, f = stamps
    return Record(
        stamps_ns=(a, b, c, d, e, f),
        report_index=0,
        placement=None if level_db is None else placement,
        level_db=level_db,
        is_click=is_click,
        drive_sequence=1 if is_sent else None,
        counters=COUNTERS,
        touches=touches_of(table, placement),
        drive=drive,
        report=b"\1",
    )


def events_of(table: Table, records: Iterable[Record]) -> list[DriveEvent]:
    """What a firmware that loses nothing would drive."""
    return RingDrive(table, RESOLUTION_HZ).events(records)


def bar_of(table: Table, records: Iterable[Record]) -> LiveBar:
    """A bar from the time 0 that is driven so."""
    bar = LiveBar(table.device)
    bar.take_events(events_of(table, records))
    return bar
