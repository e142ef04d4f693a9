"""Records of a ring as a run of a table would leave them, and the firmware's events that they stand for."""

from collections.abc import Iterable, Sequence

from engine.loop.ring import Record, RingCounters
from engine.render import clamp
from engine.table import Table
from engine.table.entry import DEFAULT_LEVEL_DB
from engine.touch import Touch, ZoneState, state_index
from firmware_link.emulator import DriveEvent
from firmware_link.protocol.messages import encode_drive
from tactable.page.live_bar import LiveBar
from tactable.page.ring_drive import RingDrive

RESOLUTION_HZ = 0.01
STAGE_NS = 10_000
COUNTERS = RingCounters(1, 2, 3, 4, 5, 6)
FRAME_US = 16_667.0
LEVEL_DB = DEFAULT_LEVEL_DB


def touches_of(table: Table, states: Sequence[ZoneState]) -> tuple[Touch, ...]:
    """A finger in the middle of every zone that is not free, numbered from 1."""
    zones = [(i, zone) for i, (zone, state) in enumerate(zip(table.device.zones, states, strict=True)) if state]
    return tuple(Touch(number, (zone.start_m + zone.stop_m) / 2, i) for number, (i, zone) in enumerate(zones, start=1))


def record_of(
    table: Table,
    states: Sequence[ZoneState],
    at_ns: int,
    *,
    is_click: bool = False,
    is_sent: bool = True,
    level_db: float | None = LEVEL_DB,
) -> Record:
    """A report that brought a state, and what was written for it 50 us later."""
    index = state_index(states)
    entry = None if level_db is None or is_click else table.entry_at(index, level_db)
    drive = b"" if entry is None else encode_drive(clamp(entry, table.device).channels, RESOLUTION_HZ)
    stamps = tuple(at_ns + STAGE_NS * stage for stage in range(6)) if is_sent else (0, at_ns, 0, 0, 0, 0)
    a, b, c, d, e, f = stamps
    return Record(
        stamps_ns=(a, b, c, d, e, f),
        report_index=0,
        state=index,
        level_db=level_db,
        is_click=is_click,
        drive_sequence=1 if is_sent else None,
        counters=COUNTERS,
        touches=touches_of(table, states),
        drive=drive,
        report=b"\1",
    )


def events_of(table: Table, records: Iterable[Record]) -> list[DriveEvent]:
    """What a firmware that loses nothing would drive."""
    return RingDrive(table, RESOLUTION_HZ).events(records)


def bar_of(table: Table, records: Iterable[Record]) -> LiveBar:
    """A bar from the time 0 that is driven so."""
    bar = LiveBar(table.device)
    bar.take(events_of(table, records))
    return bar
