"""What the compiled step must know: what stays during a run once, and the moment before each wait.

Both are written into one structure of `engine.loop.fast.fast_layout`, field by field. The link says what its next
command would be encoded with (`FastLink`), and the session confirms a frame that was written already (`FastSession`).
"""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from engine.effects.effect_play import FOLLOW_M, FURTHEST_M
from engine.effects.rules import Effects, Rule, Segment, Trigger, changed_level
from engine.loop.dispatcher import Dispatcher
from engine.loop.fast.fast_layout import CONSTANTS, NONE, Fast, FastTable
from engine.loop.fast.library import FastPathError
from engine.loop.pipeline import Pipeline
from engine.render.renderer import DriveCommand
from engine.touch import Digitizer
from engine.touch.digitizer import AGAIN
from engine.touch.finger_tracker import REACH_M
from engine.touch.placement import CLOSEST_M
from engine.touch.quirks import Key
from engine.touch.report_plan import NumberBits, ReportPlan, SlotPlan
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkState
from firmware_link.host.session import Port, Session
from firmware_link.protocol.messages import Play, Set, encode_set_body, seed_of

_NEVER_NS = (1 << 63) - 1  # the greatest int64
_QUIET = Segment(None, None)
_WIDEST_FIELD = 56  # a field is read as eight bytes from the one that it begins in
_KEYS = {
    Key.CONTACT_ID: CONSTANTS["KEY_ID"],
    Key.SLOT_IS_CONTACT_ID: CONSTANTS["KEY_SLOT"],
    Key.SLOT_IS_CONTACT_ID_MINUS_ONE: CONSTANTS["KEY_SLOT_FROM_ONE"],
    Key.SLOT_IS_CONTACT_NUMBER: CONSTANTS["KEY_NUMBER"],
}
_TRIGGERS = {Trigger.TOUCH: CONSTANTS["TOUCH"], Trigger.LIFT: CONSTANTS["LIFT"]}


class Answer(NamedTuple):
    """A packet that was read during a wait, and the frame that was written for it, where there is one."""

    packet: bytes
    frame: bytes  # empty: the compiled step declined
    written: int  # bytes of the frame that the port took
    read_ns: int
    frame_ns: int
    state_ns: int
    asked_ns: int  # the time that the frame was encoded for
    command_ns: int
    written_ns: int


@dataclass
class FastCounters:
    """Commands that the compiled step wrote: confirmed by the loop, or not the loop's, which ends the fast path."""

    answered: int = 0
    mispredicted: int = 0


class FastLink(Link):
    """A link that can say what its next command would be encoded with."""

    def write_ahead(self, fast: Any, lease_ms: int, drive_size: int, now_ns: int) -> bool:
        """Write that into the structure of the compiled step; False where it may not answer.

        Something else is sent before a command, or the device agreed to another lease or size of drives than these.
        """
        outbox, agreed = self._outbox, (self._outbox.lease.duration_ms, len(self._outbox.silent_drive))
        if self.state is not LinkState.READY or self.acknowledgements or outbox.is_waiting:
            return False
        fast.line_free_ns, fast.sequence = self._line.free_ns, self._encoder.sequence
        fast.set_from_ns, fast.play_from_ns = outbox.free_from_ns(now_ns)
        fast.clock_at_ns, fast.clock_middle_ns, fast.clock_drift = self.clock.line()
        return agreed == (lease_ms, drive_size)


class FastSession(Session):
    """A session whose next frame may have been written already."""

    def __init__(self, link: FastLink, port: Port, monotonic_ns: Callable[[], int]) -> None:
        super().__init__(link, port, monotonic_ns)
        self.fast_link = link
        self.fast_counters = FastCounters()
        self.answer: Answer | None = None  # an answer whose frame was written; the next `send` confirms it

    def send(self) -> None:
        """Write what is due, or confirm that it was written; a frame that is not the link's begins a new session."""
        answer, self.answer = self.answer, None
        if answer is None:
            super().send()
        elif self.link.outgoing(answer.asked_ns) == answer.frame:
            self.fast_counters.answered += 1
            self._unsent = answer.frame[answer.written :]
        else:
            self.fast_counters.mispredicted += 1
            self.connect()


class Moment:
    """The structure of one run, written by Python. Raises FastPathError for a digitizer or rules beyond its room."""

    def __init__(self, digitizer: Digitizer, effects: Effects, packet_head: int, timer: int) -> None:
        self.fast: Any = Fast(timer=timer, armed_ns=NONE)
        self.address = ctypes.addressof(self.fast)
        # Each look at a place of an array makes an object: they are kept.
        self._active, self._finger = [*self.fast.active], [*self.fast.finger]
        self._table: FastTable | None = None
        self._columns: list[int] = []  # of a contact, along the sides of the surface
        self._held: DriveCommand | None = None
        self._levels: dict[float | None, int] = {}
        if len(_rules_of(effects)) > CONSTANTS["MOST_RULES"]:
            raise FastPathError("there are too many rules for touches and lifts: the Python loop answers all reports")
        _set_digitizer(self.fast, digitizer, packet_head)

    def refit(self, pipeline: Pipeline, table: FastTable | None) -> None:
        """Answer with the commands of this table from now on, on the pipeline's zones and by its player's rules.

        Only wait where there is no table, where another surface does not fit that is decoded now, or where rules of a
        program do not: too many, or of other levels.
        """
        rules = _rules_of(pipeline.player.scene.effects)
        self._table = self._held = None
        try:  # it may decode another surface now
            _set_digitizer(self.fast, pipeline.digitizer, self.fast.packet_head)
        except FastPathError:
            return
        if table is None or len(rules) > CONSTANTS["MOST_RULES"]:
            return
        self._levels = {None: NONE} | {level_db: index for index, level_db in enumerate(table.levels_db)}
        if any(_first_level(rule) not in self._levels for rule in rules):
            return
        self._columns = [side.column for side in pipeline.tracker.position.sides]
        _set_surface(self.fast, pipeline)
        self._table, fast = table, self.fast
        fast.rules, fast.follows_moves = len(rules), pipeline.player.scene.follows_moves
        fast.ahead_ns = pipeline.player.ahead_ns
        for place, rule in zip(fast.rule, rules, strict=False):
            self._set_rule(place, rule)
        _set_table(fast, table)
        fast.seed[CONSTANTS["SET"]] = seed_of(Set.type_byte)
        fast.seed[CONSTANTS["PLAY"]] = seed_of(Play.type_byte)

    def _set_rule(self, place: Any, rule: Rule) -> None:
        place.trigger, place.is_click = _TRIGGERS[rule.on], _first_segment(rule).is_click
        place.level = self._levels[_first_level(rule)]
        place.zones = NONE if rule.zones is None else sum(1 << zone for zone in rule.zones)
        place.has_region = rule.zones is None and rule.region_m is not None
        for point, at_m in zip((place.start, place.stop), rule.region_m or (), strict=False):
            _set_point(point, at_m)

    def write(
        self,
        pipeline: Pipeline,
        dispatcher: Dispatcher,
        link: FastLink,
        now_ns: int,
        axis_ns: int,
        descriptors: Sequence[int],
    ) -> None:
        """Write the moment before a wait for the descriptors, the first of which is that of the packets.

        `axis_ns` is the source's time axis less the clock.
        """
        fast, table = self.fast, self._table
        fast.touch, fast.waited, fast.can_answer = descriptors[0], len(descriptors), 0
        fast.descriptor[: len(descriptors)] = descriptors
        if pipeline.player.scene.settings.level_change_db:
            return  # the step knows the levels of the rules alone
        if table is None or dispatcher.is_pending:
            return
        if not link.write_ahead(fast, table.lease_ms, table.drive_size, now_ns):
            return
        if not self._write_contacts(pipeline):
            return
        wanted, digitizer = pipeline.wanted, pipeline.digitizer
        if wanted.level_db not in self._levels:
            return
        frame = digitizer.frame
        fast.received, fast.expected, fast.ticks, fast.taken = frame.received, frame.expected, frame.ticks, frame.taken
        fast.report_ns, fast.axis_ns = frame.report_ns, axis_ns
        fast.due_ns = _NEVER_NS if pipeline.is_at_rest else pipeline.due_ns
        fast.level = self._levels[wanted.level_db]
        fast.click_ns = NONE if wanted.click_ns is None else wanted.click_ns
        self._write_held(dispatcher.held, table)
        fast.link, fast.can_answer = dispatcher.session.port.fileno(), 1

    def _write_held(self, held: DriveCommand, table: FastTable) -> None:
        """Write the drive that the device holds, which is not sent again."""
        if held is not self._held:
            self._held = held
            _set_body(self.fast.held, encode_set_body(0, table.lease_ms, held.drive or bytes(table.drive_size), 0))

    def _write_contacts(self, pipeline: Pipeline) -> bool:
        """Write contacts and fingers; False where there are too many, or where programs act on them.

        The step knows no finger that is kept quiet, no gap of a contact, and no level that the rules do not have.
        """
        fast, levels, most = self.fast, self._levels, CONSTANTS["MOST_CONTACTS"]
        frame, player = pipeline.digitizer.frame, pipeline.player
        # A frame that is under way may list fewer contacts than there are fingers.
        if frame.lifted or max(len(frame.active), len(player.fingers), len(player.lifted)) > most:
            return False
        if pipeline.digitizer.debounce is not None:
            return False
        columns = self._columns
        for active, contact in zip(self._active, frame.active.values(), strict=False):
            if contact.contact_id >= AGAIN:
                return False  # the step knows fingers by the device's ids
            active.contact_id = contact.contact_id
            for side, column in enumerate(columns):
                active.place[side] = contact[column]
            active.tip, active.seen = contact.tip, contact.contact_id in frame.seen
        fingers = (*player.fingers.values(), *player.lifted)
        for place, finger in zip(self._finger, fingers, strict=False):
            touch, play = finger.touch, finger.play
            level_db, click_ns = (None, None) if play is None else (play.level_db, play.click_ns)
            if finger.is_kept_quiet or level_db not in levels:
                return False
            place.contact_id, place.level = touch.contact_id, levels[level_db]
            _set_point(place.position, touch.position_m)
            _set_point(place.held, finger.held_m)
            _set_point(place.early, finger.early_m)
            _set_point(place.late, finger.late_m)
            place.early_ns, place.late_ns = finger.early_ns, finger.late_ns
            place.zone = NONE if touch.zone is None else touch.zone
            place.click_ns = NONE if click_ns is None else click_ns
        fast.actives, fast.fingers, fast.lifted = len(frame.active), len(player.fingers), len(player.lifted)
        return True


def _first_segment(rule: Rule) -> Segment:
    """First segment of the rule's effect; quiet where it has no segment."""
    return rule.effect.envelope[0] if rule.effect.envelope else _QUIET


def _first_level(rule: Rule) -> float | None:
    """The level that a finger feels first by a rule."""
    return changed_level(_first_segment(rule).level_db, rule.level_change_db)


def _rules_of(effects: Effects) -> list[Rule]:
    """The rules that the step follows."""
    return [rule for rule in effects.rules if rule.on in _TRIGGERS]


def _set_digitizer(fast: Any, digitizer: Digitizer, packet_head: int) -> None:
    plan, surface = digitizer.plan, digitizer.surface
    quirks, plans = plan.quirks, plan.reports
    if plan.count_is_apart:
        raise FastPathError("this digitizer sends contacts and their count apart: the Python loop answers its reports")
    slots = max(len(plan.slots) for plan in plans.values())
    if len(plans) > CONSTANTS["MOST_PLANS"] or slots > CONSTANTS["MOST_SLOTS"]:
        raise FastPathError("this digitizer has more reports, or contacts a report, than the compiled step can hold")
    fast.uses_report_ids, fast.packet_head = surface.uses_report_ids, packet_head
    fast.key = _KEYS[quirks.key]
    fast.count_is_accurate = plan.count_is_accurate
    fast.frame_may_be_empty, fast.ignores_duplicates = quirks.frame_may_be_empty, quirks.ignores_duplicates
    fast.unseen_means_up, fast.maximum_contacts = quirks.unseen_means_up, plan.maximum_contacts
    fast.plans = len(plans)


def _set_point(place: Any, at_m: complex) -> None:
    place.m[0], place.m[1] = at_m.real, at_m.imag


def _set_surface(fast: Any, pipeline: Pipeline) -> None:
    zones, sides = pipeline.device.zones, pipeline.tracker.position.sides
    fast.zones = len(zones)
    fast.follow_m, fast.furthest_m, fast.closest_m, fast.reach_m = FOLLOW_M, FURTHEST_M, CLOSEST_M, REACH_M
    for start, stop, zone in zip(fast.zone_start, fast.zone_stop, zones, strict=False):
        _set_point(start, zone.start_m)
        _set_point(stop, zone.stop_m)
    fast.side[1] = type(fast.side[1])()  # of a plate that was there before
    for place, side in zip(fast.side, sides, strict=False):
        place.start_m, place.m_per_unit, place.length_m = side.start_m, side.m_per_unit, side.length_m
        place.zero = side.zero
    # Only coordinates along the sides are read, so the plans follow from the surface, too.
    for place, (report_id, plan) in zip(fast.plan, pipeline.digitizer.plan.reports.items(), strict=False):
        _set_plan(place, report_id, plan, [side.column for side in sides])


def _set_table(fast: Any, table: FastTable) -> None:
    places, fast.places = table.places, table.places.count
    counts, corner_m = (places.along, places.across), places.corner_m
    for place, count, side_m in zip(fast.side, counts, (corner_m.real, corner_m.imag), strict=True):
        place.places, place.pitch_m = count, side_m / (count - 1) if count > 1 else 1.0
    fast.rows, fast.functions = table.weights.shape
    fast.pair, fast.head = table.pair.ctypes.data, table.head.ctypes.data
    fast.weight, fast.amplitude = table.weights.ctypes.data, table.amplitude.ctypes.data
    fast.drive = None if table.drives is None else table.drives.ctypes.data
    fast.plays_clicks = table.plays_clicks
    _set_body(fast.silence, table.silence)


def _set_body(place: Any, body: bytes) -> None:
    place.kind, place.size, place.body[: len(body)] = CONSTANTS["SET"], len(body), body


def _set_plan(place: Any, report_id: int, plan: ReportPlan, columns: Sequence[int]) -> None:
    place.report_id, place.needed_bytes, place.slots = report_id, plan.needed_bytes, len(plan.slots)
    for field, bits in ((place.count, plan.count), (place.scan_time, plan.scan_time)):
        _set_bits(field, 0 if bits is None else bits.start, (0, 0) if bits is None else (bits.shift, bits.mask))
    for slot_place, slot in zip(place.slot, plan.slots, strict=False):
        _set_slot(slot_place, slot, columns)


def _set_slot(place: Any, slot: SlotPlan, columns: Sequence[int]) -> None:
    start: int = slot.place.start
    for field in ("tip", "contact_id", "valid", "hover", "confidence"):
        _set_bits(getattr(place, field), start, getattr(slot, field))
    place.place[1] = type(place.place[1])()
    for side, column in zip(place.place, columns, strict=False):
        position = slot.x if column == 1 else slot.y
        _set_bits(side.bits, start, position[:2])
        side.sign, side.minimum, side.maximum = position[2:]


def _set_bits(place: Any, start: int, number: NumberBits) -> None:
    shift, mask = number
    if mask >> _WIDEST_FIELD:
        raise FastPathError("this digitizer has a field of more than 56 bits: the Python loop answers its reports")
    place.byte, place.shift = divmod(8 * start + shift, 8)
    place.mask = mask
