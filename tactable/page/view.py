"""The state of one run as a browser sees it: ring records and the moving bar to pictures, motions and sounds."""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from engine.effects.player import DEFAULT_CLICK_NS
from engine.loop import Stage
from engine.loop.ring import Record, RingCounters
from engine.table import Table
from engine.touch import Placement, Touch
from engine.touch.finger_tracker import ZoneEdges
from engine.touch.placement import CLOSEST_M
from firmware_link.emulator import DriveEvent
from firmware_link.emulator.synthesis import US_PER_S
from firmware_link.protocol.messages import decode_drive
from tactable.page.live_bar import LONGEST_STEP_S, POINTS, RATE_HZ, BarFinger, LiveBar, Moved
from tactable.page.messages import (
    LOWEST_DB,
    ChannelPicture,
    Drive,
    FingerPicture,
    MadePicture,
    Picture,
    Role,
    encode_motion,
    encode_sound,
)
from tactable.rig.promises import Promises

CLICK_MOTION_S = 0.09
"""Length of the slowed moment of a click: the click, and the ringing after it."""
STEADY_MOTION_S = 0.04
CAPTURE_AFTER_S = 0.4
"""A command can be seen slowed and heard this long after it; a steady one is captured repeatedly."""
HEARD_S = 0.4
LOUDER_DB = 12.0
"""Distance of the wanted level from full scale in a sound."""
LOUDEST_LEVEL_DB = 40.0
"""The wanted level that is assumed for a command at full scale."""
LATENCIES = 64
LOST_S = 0.3
"""A click that the firmware has not taken so long after it was written was refused as late."""
_MOTION_RATE_HZ = 3000
_STAGES = len(Stage) - 1
_FULL_SCALE = 32_767
_NO_COUNTERS = RingCounters(0, 0, 0, 0, 0, 0)
Stages = tuple[int, int, int, int, int]


@dataclass
class _Command:
    """A drive or click that was sent, and the levels under its fingers.

    fingers: by contact, the index of the finger of the placement that it is; promised_db (finger,), None: not known;
    simulated_db by that index.
    """

    number: int
    placement: Placement
    fingers: dict[int, int]
    at_us: float
    wanted_db: float
    drive: Drive
    is_provisional: bool
    channels: tuple[ChannelPicture, ...]
    promised_db: Sequence[float | None]
    length_s: float
    """Length of a click; infinite for a steady drive."""
    simulated_db: dict[int, float] = field(default_factory=dict)
    ended_us: float = math.inf
    sequence: int | None = None
    """Sequence number of its frame."""
    is_stalled: bool = False
    """Whether a part of its time was left out, the machine having stalled."""


class View:
    """The run of one table. Times are those of the device; `zero_ns` is host time at the device's zero."""

    def __init__(self, table: Table, bar: LiveBar, frequency_resolution_hz: float, *, has_kernels: bool = True) -> None:
        self.table, self.bar = table, bar
        self._promises_steady = has_kernels and not table.is_shipped
        self.zero_ns = 0
        self._promises, self._edges = Promises(table), ZoneEdges(table.device)
        self._promises.prepare(steady=self._promises_steady)
        self._click_length_s = max((click.length_s for click in table.clicks[:1]), default=DEFAULT_CLICK_NS / 1e9)
        self._resolution_hz = frequency_resolution_hz
        self._touches: tuple[Touch, ...] = ()
        self._counters = _NO_COUNTERS
        self._latencies_ns: deque[list[int]] = deque(maxlen=LATENCIES)
        self._command: _Command | None = None
        self._commands = 0
        self._felt_db: dict[int, float] = {}
        self._levels_db: NDArray[np.float64] = np.full(POINTS, LOWEST_DB)
        self._counted_db: NDArray[np.float64] = np.full(POINTS, LOWEST_DB)
        self._level_db: dict[int, float] = {}
        self.is_moving = False
        """Whether something moves now."""
        self._is_loaded = True
        self._captured: _Command | None = None
        """The command whose motion is captured next."""
        self._capture_us = math.inf
        self._sounds: dict[int, NDArray[np.int16]] = {}
        self._taken_us: dict[int, float] = {}  # by sequence number, when the firmware last took it

    def read(self, records: Iterable[Record]) -> None:
        """Take records of the ring."""
        for record in records:
            self._touches, self._counters = record.touches, record.counters
            if record.drive_sequence is None:
                continue
            if all(record.stamps_ns):
                stages = zip(record.stamps_ns, record.stamps_ns[1:], strict=False)
                self._latencies_ns.append([later - earlier for earlier, later in stages])
            at_us = ((record.stamps_ns[Stage.WRITTEN] or record.time_ns) - self.zero_ns) / 1e3
            if record.level_db is not None and record.placement is not None:
                self._begin(record, record.placement, record.level_db, at_us)
            elif self._command is not None:
                self._command.ended_us = min(at_us, self._command.ended_us)

    def _begin(self, record: Record, placement: Placement, level_db: float, at_us: float) -> None:
        self._commands += 1
        is_click = record.is_click and not record.drive
        promised_db: Sequence[float | None] = (None,) * len(placement.position_m)
        if is_click:
            found = self._promises.of_tabulated_click(placement, level_db)
            channels: tuple[ChannelPicture, ...] = ()
            length_s = self._click_length_s
            if found is not None:
                click, promise = found
                channels = (ChannelPicture(0.0, click.amplitude, 0.0),) * len(self.table.device.actuators)
                promised_db, length_s = promise.level_db.tolist(), click.length_s
        else:
            drive = decode_drive(record.drive, self._resolution_hz)[: len(self.table.device.actuators)]
            channels = tuple(ChannelPicture(c.frequency_hz, c.amplitude, c.phase_rad) for c in drive)
            length_s = math.inf
            if self._promises_steady:  # that of a zone is not for these positions
                held_hz = max(drive, key=lambda channel: channel.amplitude).frequency_hz if drive else None
                promised_db = self._promises.of_drive(placement, level_db, held_hz)[1].level_db.tolist()
        self._command = _Command(
            number=self._commands,
            placement=placement,
            fingers=_fingers_of(record.touches, placement),
            at_us=at_us,
            wanted_db=level_db,
            drive=Drive.CLICK if is_click else Drive.STEADY,
            is_provisional=record.is_provisional,
            channels=channels,
            promised_db=promised_db,
            length_s=length_s,
            ended_us=at_us + length_s * US_PER_S,
            sequence=record.drive_sequence,
        )
        self._counted_db, self._felt_db = np.full(POINTS, LOWEST_DB), {}
        if self._captured is None:
            self._captured, self._capture_us = self._command, at_us + CAPTURE_AFTER_S * US_PER_S

    def take(self, events: Sequence[DriveEvent]) -> None:
        """Take what the firmware drove."""
        self.bar.take(events)
        self._taken_us |= {event.sequence: event.device_time_us for event in events if event.sequence is not None}

    def move(self, until_us: float, *, is_loaded: bool) -> list[bytes]:
        """Advance the bar; returns MOTION messages of moments to be shown slowed."""
        self._is_loaded = is_loaded
        self.bar.touch([BarFinger(touch.contact_id, touch.position_m) for touch in self._touches], is_loaded=is_loaded)
        start_us = self.bar.now_us
        if until_us - start_us > LONGEST_STEP_S * US_PER_S and self._command is not None:
            self._command.is_stalled |= start_us < self._command.ended_us
        self._take(self.bar.advance(until_us), start_us)
        return self._capture()

    def _take(self, moved: Moved | None, start_us: float) -> None:
        command = self._command
        self.is_moving = moved is not None
        is_steady = command is not None and command.drive is Drive.STEADY
        if moved is None or command is None:
            self._levels_db, self._level_db = np.full(POINTS, LOWEST_DB), {}
            self._counted_db = self._levels_db if is_steady else self._counted_db
            return
        self._levels_db = moved.levels_db
        # A click counts by its greatest level, a steady drive by its present one, under fingers and between them. After
        # a stall one step may hold several commands: what was before the last one is not that one's.
        counted_db, felt_db = self.bar.greatest_since(max(command.at_us, start_us))
        self._counted_db = moved.power_levels_db if is_steady else np.maximum(self._counted_db, counted_db)
        self._level_db = dict(moved.power_db if is_steady else moved.peak_db)
        is_over = is_steady and self.bar.now_us > command.ended_us
        for touch in self._touches:
            level_db = self._level_db.get(touch.contact_id, LOWEST_DB)
            now_db = level_db if is_steady else felt_db.get(touch.contact_id, LOWEST_DB)
            self._felt_db[touch.contact_id] = max(now_db, self._felt_db.get(touch.contact_id, LOWEST_DB))
            finger = command.fingers.get(touch.contact_id)
            if finger is not None and not is_over:
                command.simulated_db[finger] = level_db if is_steady else self._felt_db[touch.contact_id]

    def _capture(self) -> list[bytes]:
        command = self._captured
        if command is None or self.bar.now_us < self._capture_us:
            return []
        is_click = command.drive is Drive.CLICK
        duration_s = CLICK_MOTION_S if is_click else STEADY_MOTION_S
        since_us = command.at_us if is_click else self._capture_us - duration_s * US_PER_S
        every = RATE_HZ // _MOTION_RATE_HZ if is_click else RATE_HZ // _MOTION_RATE_HZ // 2
        motion = self.bar.motion(since_us, duration_s, every)
        self._keep_sounds(command)
        is_on = command is self._command and self.bar.now_us < command.ended_us
        self._captured = command if is_on else None
        self._capture_us = self.bar.now_us + 1e6
        if motion is None or not motion.any():
            return []
        return [encode_motion(motion, every / RATE_HZ, command.number, is_click=is_click)]

    def _keep_sounds(self, command: _Command) -> None:
        full_scale_db = LOUDER_DB + (command.wanted_db if math.isfinite(command.wanted_db) else LOUDEST_LEVEL_DB)
        per_threshold = _FULL_SCALE / 10 ** (full_scale_db / 20)
        for touch in self._touches:
            course = self.bar.felt(touch.contact_id)
            if course is not None:
                heard = course[-round(HEARD_S * RATE_HZ) :] * per_threshold
                self._sounds[touch.contact_id] = np.clip(np.rint(heard), -_FULL_SCALE, _FULL_SCALE).astype(np.int16)

    def sound(self, finger: int) -> bytes | None:
        """SOUND of the last captured command under a finger; None where the finger felt none."""
        samples = self._sounds.get(finger)
        return None if samples is None else encode_sound(finger, RATE_HZ, samples)

    def picture(self) -> Picture:
        """The present state."""
        command, now_us = self._command, self.bar.now_us
        latest = self._latencies_ns[-1] if self._latencies_ns else [0] * _STAGES
        median = np.median(self._latencies_ns, axis=0) if self._latencies_ns else np.zeros(_STAGES)
        return Picture(
            time_s=now_us / US_PER_S,
            counters=self._counters,
            command=0 if command is None else command.number,
            age_s=0.0 if command is None else max(0.0, (now_us - command.at_us) / US_PER_S),
            wanted_db=0.0 if command is None else command.wanted_db,
            last_ns=_stages(latest),
            median_ns=_stages(median.tolist()),
            latencies=len(self._latencies_ns),
            drive=Drive.SILENCE if command is None else command.drive,
            is_loaded=self._is_loaded,
            is_playing=command is not None and now_us < command.ended_us,
            is_provisional=command is not None and command.is_provisional,
            is_late=command is not None and self._is_late(command),
            fingers=tuple(self._finger(touch) for touch in self._touches),
            made=() if command is None else self._made(command),
            channels=() if command is None else command.channels,
            levels_db=self._levels_db,
            counted_db=self._counted_db,
        )

    def _is_late(self, command: _Command) -> bool:
        """Whether what a command did cannot be judged; a steady drive that is there already causes no event."""
        if command.is_stalled or command.drive is not Drive.CLICK or command.sequence is None:
            return command.is_stalled
        # Sequence numbers come again after 256 commands.
        taken_us = self._taken_us.get(command.sequence, -math.inf)
        return taken_us < command.at_us - US_PER_S and self.bar.now_us > command.at_us + LOST_S * US_PER_S

    def _finger(self, touch: Touch) -> FingerPicture:
        number, command = touch.contact_id, self._command
        finger = None if command is None else command.fingers.get(number)
        role = Role.NONE if command is None or finger is None else _role(command.placement, finger)
        level_db, felt_db = self._level_db.get(number, LOWEST_DB), self._felt_db.get(number, LOWEST_DB)
        return FingerPicture(number, touch.zone, role, touch.position_m, level_db, felt_db)

    def _made(self, command: _Command) -> tuple[MadePicture, ...]:
        here = {touch.contact_id for touch in self._touches}
        numbers = {finger: number for number, finger in command.fingers.items() if number in here}
        return tuple(
            MadePicture(
                number=numbers.get(finger),
                zone=self._edges.zone_at(at_m),
                role=_role(command.placement, finger),
                position_m=at_m,
                promised_db=command.promised_db[finger],
                simulated_db=command.simulated_db.get(finger),
            )
            for finger, at_m in enumerate(command.placement.position_m)
        )


def _fingers_of(touches: Iterable[Touch], placement: Placement) -> dict[int, int]:
    """By contact, the index of the nearest finger of a placement; a contact without one that is near is absent."""
    found = dict[int, int]()
    for touch in touches:
        distance_m, finger = min((abs(at_m - touch.position_m), k) for k, at_m in enumerate(placement.position_m))
        if distance_m < CLOSEST_M:
            found[touch.contact_id] = finger
    return found


def _role(placement: Placement, finger: int) -> Role:
    return Role.FELT if placement.is_felt[finger] else Role.QUIET


def _stages(values: Iterable[float]) -> Stages:
    a, b, c, d, e = (min(max(round(value), 0), 0xFFFF_FFFF) for value in values)
    return a, b, c, d, e
