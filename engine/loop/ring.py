"""A ring buffer in shared memory: one process writes the loop's records, any number of processes read them.

The writer never waits for a reader and does not know the readers. A reader that is too slow loses the oldest records
and counts them. Each record carries a checksum of its bytes and its own number, so a reader rejects a record that is
being overwritten, in whatever order the processor's stores become visible.
"""

import mmap
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple, Self

from base.errors import TactableError
from base.points import point_of, sides_of
from engine.loop.observer import CommandRecord, Fate, LoopCounters, Stamps
from engine.touch import Placement, Touch
from engine.touch.placement import MOST_FINGERS

MAGIC = b"tactring"
REVISION = 5  # raise it with any change of the structures below
MOST_TOUCHES = 16
SLOTS = 4096  # half a second of the fastest digitizer, 8000 reports a second; 8 MiB

_HEAD = struct.Struct("<8sIIIIQ")  # magic, revision, bytes of a slot, slots, process, records written
_WRITTEN_AT = _HEAD.size - 8
_COUNT = struct.Struct("<Q")
_HEAD_SIZE = 64  # a cache line: the count of records shares none with a slot
_GUARD = struct.Struct("<IIQ")  # CRC-32 of the rest, then the number of the record, from 1
# six stamps, report index, level, is_click, sequence, counters, the fingers that feel as bits, then how many of
# fingers, touches, drive, play, effect's name and report; no finger stands for no placement
_FIXED = struct.Struct("<6qqd?h6QHBBHHBH")
# points are x and y, which is NaN on a bar
_FINGERS = [struct.Struct(f"<{2 * count}d") for count in range(MOST_FINGERS + 1)]
_TOUCH = struct.Struct("<qddb?")
_LONGEST_NAME = 64  # bytes in UTF-8
_NO_LEVEL = float("-inf")
_NO_FINGER = Placement((), ())
_NONE = -1
_SLOT_SIZE = 2048  # 16 touches, 10 fingers and a click of 176 weights leave 900 bytes to the report, which is cut


class RingError(TactableError):
    """A ring that cannot be made or read; the message has the remedy."""


class RingCounters(NamedTuple):
    """The counts of the loop at the end of the record's pass."""

    reports: int
    frames: int
    state_changes: int
    commands: int
    replaced: int  # commands that a newer one replaced unsent
    lost_frames: int  # frames that the digitizer lost


class Record(NamedTuple):
    """A `CommandRecord` as the ring holds it, with the counts of its pass.

    `stamps_ns` are in the order of `Stage`; 0 stands for a stage that was not reached, such as COMMAND where nothing
    else is wanted.
    """

    stamps_ns: Stamps
    report_index: int | None  # index of the report that caused the change; None where time caused it
    placement: Placement | None  # the fingers that the command is for, with their roles; None: no finger feels
    level_db: float | None
    is_click: bool
    drive_sequence: int | None  # sequence of the SET or PLAY that was written; None without one
    counters: RingCounters
    touches: tuple[Touch, ...]  # at most 16 fingers; others are left out
    drive: bytes  # the drive that the device holds from then on, as on the wire; empty for silence
    report: bytes  # the report as the device sent it, cut where it does not fit
    play: bytes = b""  # the PLAY of a click that was written, behind its clock reference; empty for all else
    effect: str = ""  # name of the effect that is wanted, cut after 64 bytes; "": none is

    @property
    def time_ns(self) -> int:
        """Time at which the report was read, or a change without a report was known."""
        return self.stamps_ns[1]


class RingWriter:
    """Makes a ring at `path` and writes records; `close` removes it. Raises RingError where it cannot be made."""

    def __init__(self, path: Path, slots: int = SLOTS) -> None:
        self.path = path
        self.written = 0
        self._slots = slots
        size = _HEAD_SIZE + slots * _SLOT_SIZE
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise RingError(f"{path}: no ring can be made there ({error}): choose another place") from error
        try:
            # Every page is touched now, so that the loop waits for no page fault.
            os.posix_fallocate(descriptor, 0, size)
            self._memory = mmap.mmap(descriptor, size)
        except OSError as error:
            path.unlink(missing_ok=True)
            raise RingError(f"{path}: no ring of {size} bytes can be made there ({error}): make room") from error
        finally:
            os.close(descriptor)
        _HEAD.pack_into(self._memory, 0, MAGIC, REVISION, _SLOT_SIZE, slots, os.getpid(), 0)

    def begin_run(self, time_ns: int) -> None:
        """Write that no finger touches: those of the run before may lift before this one reads them."""
        stamps_ns = (time_ns, 0, 0, 0, 0, 0)
        self.observe(
            CommandRecord(stamps_ns, None, b"", None, None, None, False, (), b"", Fate.NONE, None), LoopCounters()
        )

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:
        """Write a record, in place of the oldest where all slots are taken."""
        touches, drive, play, report = record.touches, record.drive, record.play, record.report
        placement = _NO_FINGER if record.placement is None else record.placement
        position_m = placement.position_m
        count, fingers = min(len(touches), MOST_TOUCHES), _FINGERS[len(position_m)]
        name = record.effect.encode()[:_LONGEST_NAME]
        taken = fingers.size + count * _TOUCH.size + len(drive) + len(play) + len(name)
        room = _SLOT_SIZE - _GUARD.size - _FIXED.size - taken
        index = _NONE if record.report_index is None else record.report_index
        level_db = _NO_LEVEL if record.level_db is None else record.level_db
        sequence = _NONE if record.drive_sequence is None else record.drive_sequence
        wanted = (index, level_db, record.is_click, sequence)
        of_reports = (counters.reports, counters.frames, counters.state_changes)
        of_commands = (counters.commands, counters.replaced, counters.lost_frames)
        felt = sum(1 << finger for finger in placement.felt)
        sizes = (len(position_m), count, len(drive), len(play), len(name), min(len(report), room))
        fixed = _FIXED.pack(*record.stamps_ns, *wanted, *of_reports, *of_commands, felt, *sizes)
        packed = [_TOUCH.pack(t[0], *sides_of(t[1]), _NONE if t[2] is None else t[2], t[3]) for t in touches[:count]]
        places = fingers.pack(*chain.from_iterable(map(sides_of, position_m)))
        body = b"".join((fixed, places, *packed, drive, play, name, report[:room]))
        start = _HEAD_SIZE + self.written % self._slots * _SLOT_SIZE
        self.written += 1
        end = start + _GUARD.size + len(body)
        self._memory[start + _GUARD.size : end] = body
        _GUARD.pack_into(self._memory, start, zlib.crc32(body, self.written & 0xFFFF_FFFF), len(body), self.written)
        _COUNT.pack_into(self._memory, _WRITTEN_AT, self.written)

    def close(self) -> None:
        """Remove the ring; readers keep what they have."""
        self._memory.close()
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()


class RingReader:
    """Reads the records of a ring, from the next that is written on; `lost` were overwritten before they were read.

    Raises RingError for a path without a ring of this revision.
    """

    def __init__(self, path: Path, *, from_start: bool = False) -> None:
        self.path = path
        self.lost = 0
        try:
            with path.open("rb") as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise RingError(f"{path}: there is no ring ({error}): start the run that writes it") from error
        if len(self._memory) < _HEAD_SIZE or self._memory[: len(MAGIC)] != MAGIC:
            raise RingError(f"{path}: is no ring: give the path that the run says")
        _, revision, size, self._slots, self.process_id, written = _HEAD.unpack_from(self._memory)
        if revision != REVISION or size != _SLOT_SIZE:
            raise RingError(f"{path}: is a ring of revision {revision}, ours {REVISION}: use one version of tactable")
        self._next = max(0, written - self._slots) if from_start else written

    def skip_to(self, index: int) -> None:
        """Leave out records before this one."""
        self._next = max(self._next, index)

    def read(self) -> Iterator[Record]:
        """Every record that is there and was not read yet, in order."""
        (written,) = _COUNT.unpack_from(self._memory, _WRITTEN_AT)
        while self._next < written:
            behind = written - self._next - self._slots
            if behind > 0:
                self.lost += behind
                self._next += behind
            record = self._record(self._next)
            self._next += 1
            if record is None:
                self.lost += 1
            else:
                yield record
            (written,) = _COUNT.unpack_from(self._memory, _WRITTEN_AT)

    def close(self) -> None:
        """Let go of the memory."""
        self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def _record(self, index: int) -> Record | None:
        """The record, or None while it is being overwritten."""
        start = _HEAD_SIZE + index % self._slots * _SLOT_SIZE
        slot = self._memory[start : start + _SLOT_SIZE]
        checksum, size, number = _GUARD.unpack_from(slot)
        body = slot[_GUARD.size : _GUARD.size + size]
        if number != index + 1 or len(body) != size or zlib.crc32(body, number & 0xFFFF_FFFF) != checksum:
            return None
        return _decode(body)


def _decode(body: bytes) -> Record:
    values = _FIXED.unpack_from(body)
    stamps, (index, level_db, is_click, sequence), counters = values[:6], values[6:10], values[10:16]
    felt, fingers, count, drive_size, play_size, name_size, report_size = values[16:]
    fingers_end = _FIXED.size + _FINGERS[fingers].size
    touches_end = fingers_end + count * _TOUCH.size
    drive_end = touches_end + drive_size
    play_end = drive_end + play_size
    name_end = play_end + name_size
    return Record(
        stamps_ns=stamps,
        report_index=None if index == _NONE else index,
        placement=_placement(_FINGERS[fingers].unpack_from(body, _FIXED.size), felt) if fingers else None,
        level_db=None if level_db == _NO_LEVEL else level_db,
        is_click=is_click,
        drive_sequence=None if sequence == _NONE else sequence,
        counters=RingCounters(*counters),
        touches=tuple(
            Touch(number, point_of(x_m, y_m), None if zone == _NONE else zone, is_palm)
            for number, x_m, y_m, zone, is_palm in _TOUCH.iter_unpack(body[fingers_end:touches_end])
        ),
        drive=body[touches_end:drive_end],
        report=body[name_end : name_end + report_size],
        play=body[drive_end:play_end],
        effect=body[play_end:name_end].decode(errors="ignore"),
    )


def _placement(sides_m: Sequence[float], felt: int) -> Placement:
    position_m = tuple(map(point_of, sides_m[::2], sides_m[1::2]))
    return Placement(position_m, tuple(bool(felt >> finger & 1) for finger in range(len(position_m))))
