"""The compiled step from a report to its command, and what it must know before each wait (engine/loop/fast/step.c).

The operating system wakes a process up in 25 us; then Python, its caches cold, needs 20 us more, the compiled step 2.
It decides nothing: the loop takes the same report afterwards, finds the same frame and goes on from there. Where it
does not, or where something is rare, the loop's own way is all there is.
"""

import ctypes
import os
import shutil
import struct
import subprocess
import sys
import weakref
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from engine.effects import EffectPlayer, Effects, Rule, Trigger
from engine.effects.player import Feeling
from engine.files import replace_file
from engine.loop.fast.table import COMMAND, FastTable
from engine.render.renderer import Command
from engine.touch import Digitizer, FingerTracker
from engine.touch.digitizer import Bits, NumberBits, ReportPlan, SlotPlan
from engine.touch.quirks import Key
from engine.touch.sources import Source
from firmware_link.host.link import Link
from firmware_link.protocol.errors import TactableError
from firmware_link.protocol.messages import Play, Set, seed_of

SOURCE = Path(__file__).with_name("step.c")
NONE = -1
_COMPILERS = ("cc", "gcc", "clang")
# Without contraction: a product and a sum in one step would round otherwise than Python does.
_FLAGS = ("-O2", "-std=c11", "-ffp-contract=off", "-shared", "-fPIC")
_MOST_PLANS, _MOST_SLOTS, _MOST_CONTACTS, _MOST_ZONES, _MOST_RULES, _MOST_WAITED = 8, 40, 64, 16, 64, 4
_PACKET_SIZE, _FRAME_SIZE = 4096, 256
# A field is read as eight bytes from the one that it begins in.
_WIDEST_FIELD = 56
_KEYS = (Key.CONTACT_ID, Key.SLOT_IS_CONTACT_ID, Key.SLOT_IS_CONTACT_ID_MINUS_ONE, Key.SLOT_IS_CONTACT_NUMBER)
_TRIGGERS = (Trigger.TOUCH, Trigger.LIFT)


class FastPathError(TactableError):
    """There is no compiled step here: why, and what would give one."""


@runtime_checkable
class PacketSource(Source, Protocol):
    """A source whose reports somebody else may read: each read of a descriptor gives one packet, which holds one."""

    @property
    def packet_head(self) -> int:
        """Bytes before the report: 0, or 8 and more, of which the first 8 are the report's time."""

    def packet_fileno(self) -> int | None:
        """The descriptor; None while there is none."""

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:
        """The report in a packet that was read at clock time `now_ns`, as if `read` had given it.

        `is_last` says that there was no other behind it.
        """


class Answer(NamedTuple):
    """A packet that was taken during a wait, and the frame that was written for it, where there is one."""

    packet: bytes
    frame: bytes
    """Empty: what it brings, if anything, is the loop's to find out."""
    written: int
    """Bytes of the frame that the port took."""
    woken_ns: int
    read_ns: int
    frame_ns: int
    state_ns: int
    asked_ns: int
    """When the link was asked what the frame is to say."""
    command_ns: int
    written_ns: int


def compile_fast_path(folder: Path) -> ctypes.CDLL:
    """The library in `folder`, compiled there unless it is there already. Raises FastPathError."""
    source = SOURCE.read_bytes()
    path = folder / f"fast_path-{zlib.crc32(source + ' '.join(_FLAGS).encode()):08x}.so"
    if sys.byteorder != "little":
        raise FastPathError("this machine is big-endian: reports take the long way")
    try:
        if not path.exists():
            _compile(path)
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise FastPathError(f"{path} cannot be made or opened: {error}") from error
    library.fast_wait.argtypes = (ctypes.c_void_p, ctypes.c_int64)
    library.fast_wait.restype = library.fast_answer.restype = library.fast_size.restype = ctypes.c_int64
    library.fast_answer.argtypes = (ctypes.c_void_p,)
    library.fast_set_time.argtypes = (ctypes.c_int64,)
    if library.fast_size() != ctypes.sizeof(_Fast):
        raise FastPathError(f"{path} was compiled with another layout: remove it")
    library.fast_start()
    return library


def _compile(path: Path) -> None:
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        raise FastPathError("no C compiler: install one (gcc) and commands leave some 20 us sooner")
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as made:
        command = [compiler, *_FLAGS, "-o", str(made), str(SOURCE), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise FastPathError(f"{compiler} does not compile {SOURCE.name}: {done.stderr.strip()[-500:]}")


class FastPath:
    """One run's compiled step between its source and its link; `refit` again when table or zones change.

    Raises FastPathError for a digitizer or rules that it has no room for.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        source: PacketSource,
        digitizer: Digitizer,
        player: EffectPlayer,
        effects: Effects,
        now_ns: Callable[[], int],
    ) -> None:
        self._library, self._now_ns = library, now_ns
        self._source, self._digitizer, self._player = source, digitizer, player
        self._rules = [rule for rule in effects.rules if rule.on in _TRIGGERS]
        if len(self._rules) > _MOST_RULES:
            raise FastPathError(f"more than {_MOST_RULES} rules for touches and lifts: reports take the long way")
        self._fast = _Fast(timer=library.fast_open_timer(), armed_ns=NONE)
        if self._fast.timer < 0:
            raise FastPathError("the system gives no timer: reports take the long way")
        weakref.finalize(self, os.close, self._fast.timer)
        self._address = ctypes.addressof(self._fast)
        self._memory = memoryview((ctypes.c_uint8 * ctypes.sizeof(_Fast)).from_buffer(self._fast)).cast("B")
        self._table: FastTable | None = None
        self._levels: dict[float | None, int] = {}
        self._tracker: FingerTracker | None = None
        self._set_digitizer(digitizer, source.packet_head)

    def refit(self, tracker: FingerTracker, table: FastTable | None) -> None:
        """Answer with these commands from now on, for fingers on these zones; with None it only waits."""
        self._tracker, self._table = tracker, table
        if table is None:
            return
        self._levels = {None: NONE} | {level_db: index for index, level_db in enumerate(table.levels_db)}
        self._set_zones(tracker)
        self._set_rules()
        fast = self._fast
        fast.states = table.command_of.shape[2]
        fast.command_of, fast.command = table.command_of.ctypes.data, table.commands.ctypes.data
        fast.seed[1], fast.seed[2] = (seed_of(message.type_byte) or 0 for message in (Set, Play))

    def packet_fileno(self) -> int | None:
        """What packets come from; None: wait without the fast path."""
        return self._source.packet_fileno()

    def report_of(self, answer: Answer) -> bytes:
        """The report that was taken, now one of the source's."""
        return self._source.take_packet(answer.packet, answer.read_ns, is_last=bool(answer.frame))

    def wait(
        self,
        until_ns: int | None,
        descriptors: Sequence[int],
        link: Link | None,
        port: int,
        due_ns: float,
        wanted: tuple[int, float | None, int | None],
        held: Command,
    ) -> tuple[list[int], Answer | None]:
        """Wait until `until_ns` or until a descriptor can be read, the first of which is that of the packets.

        `link` sends to `port`; None where something else is under way on it. `due_ns` is when time alone brings
        something, on the source's axis; `wanted` is state, level and click that were wanted last, `held` what the
        device holds. Returns the descriptors that can be read, and the packet that was.
        """
        self._tell(descriptors, link, port, due_ns, wanted, held)
        self._run(NONE if until_ns is None else until_ns)
        result = _RESULT.unpack_from(self._memory, _Fast.readable.offset)
        readable = [descriptor for descriptor, is_readable in zip(descriptors, result, strict=False) if is_readable]
        size, frame_size, written = result[_MOST_WAITED : _MOST_WAITED + 3]
        if not size:
            return readable, None
        packet = bytes(self._memory[_Fast.packet.offset : _Fast.packet.offset + size])
        frame = bytes(self._memory[_Fast.frame.offset : _Fast.frame.offset + frame_size])
        return readable, Answer(packet, frame, written, *result[_MOST_WAITED + 3 :])

    def _run(self, until_ns: int) -> None:
        self._library.fast_wait(self._address, until_ns)

    def _tell(
        self,
        descriptors: Sequence[int],
        link: Link | None,
        port: int,
        due_ns: float,
        wanted: tuple[int, float | None, int | None],
        held: Command,
    ) -> None:
        memory, table, source = self._memory, self._table, self._source
        waited = (*descriptors, *(NONE,) * (_MOST_WAITED - len(descriptors)))
        now_ns = self._now_ns()
        ahead = None if link is None or table is None else link.ahead(now_ns)
        fingers, lifted = self._player.fingers()
        active, seen = self._digitizer.active()
        contacts = list(active)
        if (
            ahead is None
            or table is None
            or self._tracker is None
            or (ahead.lease_ms, ahead.drive_size) != (table.lease_ms, table.drive_size)
            or len(lifted) > _MOST_CONTACTS
            or len(contacts) > _MOST_CONTACTS
        ):
            _WAITED.pack_into(memory, _Fast.can_answer.offset, 0, descriptors[0], port, len(descriptors), *waited)
            return
        numbers, levels = table.numbers, self._levels
        state, level_db, click_ns = wanted
        tracked = self._tracker.zones()
        column = self._tracker.position.column
        _MOMENT.pack_into(
            memory,
            _Fast.can_answer.offset,
            1,
            descriptors[0],
            port,
            len(descriptors),
            *waited,
            source.source_time_ns(now_ns) - now_ns,
            *self._digitizer.moment(),
            _NEVER_NS if due_ns > _NEVER_NS else int(due_ns),
            state,
            levels[level_db],
            NONE if click_ns is None else click_ns,
            numbers.get(held, NONE),
            *ahead[2:],
            len(contacts),
            len(tracked),
            len(fingers),
            len(lifted),
        )
        at = _Fast.active.offset
        for contact in contacts:
            _FOUR.pack_into(memory, at, contact[0], contact[column], contact[3], contact[0] in seen)
            at += _FOUR.size
        at = _Fast.tracked.offset
        for contact_id, zone in tracked:
            _TWO.pack_into(memory, at, contact_id, NONE if zone is None else zone)
            at += _TWO.size
        at = _Fast.finger.offset
        for finger in (*fingers, *lifted):
            self._tell_finger(at, finger)
            at += _FINGER.size

    def _tell_finger(self, at: int, finger: Feeling) -> None:
        (contact_id, position_m, zone), level_db, click_ns = finger
        zone_number = NONE if zone is None else zone
        click = NONE if click_ns is None else click_ns
        _FINGER.pack_into(self._memory, at, contact_id, zone_number, self._levels[level_db], click, position_m)

    # ---- what does not change during a run ----

    def _set_digitizer(self, digitizer: Digitizer, packet_head: int) -> None:
        fast, quirks = self._fast, digitizer.quirks
        if digitizer.count_is_apart:
            raise FastPathError("this digitizer tells contacts and their count apart: its reports take the long way")
        slots = max(len(plan.slots) for plan in digitizer.plans.values())
        if len(digitizer.plans) > _MOST_PLANS or slots > _MOST_SLOTS:
            raise FastPathError("this digitizer has more reports or contacts a report than there is room for")
        fast.uses_report_ids, fast.packet_head = digitizer.uses_report_ids, packet_head
        fast.key = _KEYS.index(quirks.key)
        fast.count_is_accurate = digitizer.count_is_accurate
        fast.frame_may_be_empty, fast.ignores_duplicates = quirks.frame_may_be_empty, quirks.ignores_duplicates
        fast.unseen_means_up, fast.maximum_contacts = quirks.unseen_means_up, digitizer.maximum_contacts
        fast.plans = len(digitizer.plans)

    def _set_zones(self, tracker: FingerTracker) -> None:
        fast, position, edges = self._fast, tracker.position, tracker.edges
        fast.zones, fast.hysteresis_m = len(edges.starts_m), edges.hysteresis_m
        fast.zone_start_m[: fast.zones], fast.zone_stop_m[: fast.zones] = edges.starts_m, edges.stops_m
        fast.start_m, fast.m_per_unit, fast.length_m = position.start_m, position.m_per_unit, position.length_m
        fast.zero = position.zero
        for place, (report_id, plan) in zip(fast.plan, self._digitizer.plans.items(), strict=False):
            _set_plan(place, report_id, plan, position.column)

    def _set_rules(self) -> None:
        fast = self._fast
        fast.rules, fast.follows_moves = len(self._rules), self._player.follows_moves
        for place, rule in zip(fast.rule, self._rules, strict=False):
            self._set_rule(place, rule)

    def _set_rule(self, place: "_Rule", rule: Rule) -> None:
        first = rule.effect.envelope[0]
        place.trigger, place.is_click = _TRIGGERS.index(rule.on), first.is_click
        place.level = self._levels[first.level_db]
        place.zones = NONE if rule.zones is None else sum(1 << zone for zone in rule.zones)
        place.start_m, place.stop_m = (1.0, 0.0) if rule.zones is not None or rule.region_m is None else rule.region_m


def _set_plan(place: "_Plan", report_id: int, plan: ReportPlan, column: int) -> None:
    place.report_id, place.needed_bytes, place.slots = report_id, plan.needed_bytes, len(plan.slots)
    place.count, place.scan_time = _whole(plan.count), _whole(plan.scan_time)
    for slot_place, slot in zip(place.slot, plan.slots, strict=False):
        _set_slot(slot_place, slot, column)


def _set_slot(place: "_Slot", slot: SlotPlan, column: int) -> None:
    start: int = slot.place.start
    position = slot.x if column == 1 else slot.y
    place.tip, place.contact_id = _bits(slot.tip, start), _bits(slot.contact_id, start)
    place.valid, place.hover = _bits(slot.valid, start), _bits(slot.hover, start)
    place.place = _bits(position[:2], start)
    place.sign, place.minimum, place.maximum = position[2:]


def _whole(bits: Bits | None) -> "_Bits":
    return _Bits(0, 0, 0) if bits is None else _bits((bits.shift, bits.mask), bits.start)


def _bits(number: NumberBits, start: int) -> "_Bits":
    shift, mask = number
    if mask >> _WIDEST_FIELD:
        raise FastPathError("this digitizer has a field of more than 56 bits: its reports take the long way")
    bit = 8 * start + shift
    return _Bits(bit // 8, bit % 8, mask)


# ---- the layout of engine/loop/fast/step.c ----

_NEVER_NS = (1 << 63) - 1
_q, _d = ctypes.c_int64, ctypes.c_double


def _numbers(names: str) -> list[tuple[str, type[ctypes.c_int64]]]:
    return [(name, _q) for name in names.split()]


class _Bits(ctypes.Structure):
    _fields_ = _numbers("byte shift mask")


class _Slot(ctypes.Structure):
    _fields_ = [
        *((name, _Bits) for name in ("tip", "contact_id", "valid", "hover", "place")),
        *_numbers("sign minimum maximum"),
    ]


class _Plan(ctypes.Structure):
    _fields_ = [
        *_numbers("report_id needed_bytes slots"),
        ("count", _Bits),
        ("scan_time", _Bits),
        ("slot", _Slot * _MOST_SLOTS),
    ]


class _Rule(ctypes.Structure):
    _fields_ = [*_numbers("trigger zones level is_click"), ("start_m", _d), ("stop_m", _d)]


class _Fast(ctypes.Structure):
    _fields_ = [
        *_numbers("uses_report_ids packet_head plans key count_is_accurate frame_may_be_empty ignores_duplicates"),
        *_numbers("unseen_means_up maximum_contacts zones rules follows_moves states zero timer armed_ns"),
        *((name, _d) for name in ("start_m", "m_per_unit", "length_m", "hysteresis_m")),
        ("zone_start_m", _d * _MOST_ZONES),
        ("zone_stop_m", _d * _MOST_ZONES),
        ("rule", _Rule * _MOST_RULES),
        ("plan", _Plan * _MOST_PLANS),
        ("command_of", ctypes.c_void_p),
        ("command", ctypes.c_void_p),
        ("seed", _q * 3),
        *_numbers("can_answer touch link waited"),
        ("descriptor", _q * _MOST_WAITED),
        *_numbers("axis_ns received expected ticks taken report_ns due_ns state level click_ns held"),
        *_numbers("line_free_ns set_from_ns play_from_ns sequence clock_at_ns"),
        ("clock_middle_ns", _d),
        ("clock_drift", _d),
        *_numbers("actives tracked_count fingers lifted"),
        ("active", _q * (4 * _MOST_CONTACTS)),
        ("tracked", _q * (2 * _MOST_CONTACTS)),
        ("finger", _q * (5 * 2 * _MOST_CONTACTS)),
        ("readable", _q * _MOST_WAITED),
        *_numbers("packet_size frame_size written woken_ns read_ns frame_ns state_ns asked_ns command_ns written_ns"),
        ("packet", ctypes.c_uint8 * (_PACKET_SIZE + 16)),
        ("frame", ctypes.c_uint8 * _FRAME_SIZE),
    ]


_WAITED = struct.Struct("=8q")
_MOMENT = struct.Struct("=24q2d4q")
_FOUR, _TWO, _FINGER = struct.Struct("=4q"), struct.Struct("=2q"), struct.Struct("=4qd")
_RESULT = struct.Struct("=14q")
assert COMMAND.itemsize == 256  # as `Command` there
