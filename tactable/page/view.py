"""The state of one run as a browser sees it: ring records and the moving bar to pictures, motions and sounds."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from engine.loop import Stage
from engine.loop.ring import Record, RingCounters
from engine.table import Table
from engine.touch import Touch, ZoneState
from firmware_link.emulator.synthesis import US_PER_S
from firmware_link.protocol.messages import decode_drive
from tactable.page.live_bar import POINTS, RATE_HZ, BarFinger, LiveBar, Moved
from tactable.page.messages import (
    LOWEST_DB,
    ChannelPicture,
    Drive,
    FingerPicture,
    Picture,
    ZonePicture,
    encode_motion,
    encode_sound,
)

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
_MOTION_RATE_HZ = 3000
_STAGES = len(Stage) - 1
_FULL_SCALE = 32_767
_NO_COUNTERS = RingCounters(0, 0, 0, 0, 0, 0)
Stages = tuple[int, int, int, int, int]


@dataclass
class _Command:
    """A drive or click that was sent, and the levels under the fingers."""

    number: int
    state: int
    at_us: float
    wanted_db: float
    drive: Drive
    channels: tuple[ChannelPicture, ...]
    promised_db: dict[int, float]
    """By zone."""
    length_s: float
    """Length of a click; infinite for a steady drive."""
    simulated_db: dict[int, float] = field(default_factory=dict)
    """By zone."""
    ended_us: float = math.inf


class View:
    """The run of one table. Times are those of the device; `zero_ns` is host time at the device's zero."""

    def __init__(self, table: Table, bar: LiveBar, frequency_resolution_hz: float) -> None:
        self.table, self.bar = table, bar
        self.zero_ns = 0
        self._resolution_hz = frequency_resolution_hz
        self._touches: tuple[Touch, ...] = ()
        self._state = 0
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

    def read(self, records: Iterable[Record]) -> None:
        """Take records of the ring."""
        for record in records:
            self._touches, self._state, self._counters = record.touches, record.state, record.counters
            if record.drive_sequence is None:
                continue
            if all(record.stamps_ns):
                stages = zip(record.stamps_ns, record.stamps_ns[1:], strict=False)
                self._latencies_ns.append([later - earlier for earlier, later in stages])
            at_us = ((record.stamps_ns[Stage.WRITTEN] or record.time_ns) - self.zero_ns) / 1e3
            if record.level_db is not None:
                self._begin(record, record.level_db, at_us)
            elif self._command is not None:
                self._command.ended_us = min(at_us, self._command.ended_us)

    def _begin(self, record: Record, level_db: float, at_us: float) -> None:
        click = self.table.click_at(record.state, level_db) if record.is_click and not record.drive else None
        entry = self.table.entry_at(record.state, level_db)
        self._commands += 1
        if click is not None:
            promised = {i: zone.level_db for i, zone in enumerate(click.zones) if zone is not None}
            channels = tuple(ChannelPicture(0.0, click.amplitude, 0.0) for _ in self.table.device.actuators)
            length_s = click.length_s
        else:
            zones = () if entry is None else entry.zones
            promised = {i: z.sensation_level_db for i, z in enumerate(zones) if z.sensation_level_db is not None}
            drive = decode_drive(record.drive, self._resolution_hz)[: len(self.table.device.actuators)]
            channels = tuple(ChannelPicture(c.frequency_hz, c.amplitude, c.phase_rad) for c in drive)
            length_s = math.inf
        kind = Drive.STEADY if click is None else Drive.CLICK
        self._command = _Command(
            self._commands,
            record.state,
            at_us,
            level_db,
            kind,
            channels,
            promised,
            length_s,
            {},
            at_us + length_s * 1e6,
        )
        self._counted_db, self._felt_db = np.full(POINTS, LOWEST_DB), {}
        if self._captured is None:
            self._captured, self._capture_us = self._command, at_us + CAPTURE_AFTER_S * US_PER_S

    def move(self, until_us: float, *, is_loaded: bool) -> list[bytes]:
        """Advance the bar; returns MOTION messages of moments to be shown slowed."""
        self._is_loaded = is_loaded
        self.bar.touch([BarFinger(touch.contact_id, touch.position_m) for touch in self._touches], is_loaded=is_loaded)
        start_us = self.bar.now_us
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
            if touch.zone is not None and not is_over:
                command.simulated_db[touch.zone] = level_db if is_steady else self._felt_db[touch.contact_id]

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
            state=0 if command is None else command.state,
            age_s=0.0 if command is None else max(0.0, (now_us - command.at_us) / US_PER_S),
            wanted_db=0.0 if command is None else command.wanted_db,
            last_ns=_stages(latest),
            median_ns=_stages(median.tolist()),
            latencies=len(self._latencies_ns),
            drive=Drive.SILENCE if command is None else command.drive,
            is_loaded=self._is_loaded,
            is_playing=command is not None and now_us < command.ended_us,
            fingers=tuple(self._finger(touch) for touch in self._touches),
            zones=tuple(self._zone(zone) for zone in range(len(self.table.device.zones))),
            channels=() if command is None else command.channels,
            levels_db=self._levels_db,
            counted_db=self._counted_db,
        )

    def _finger(self, touch: Touch) -> FingerPicture:
        number = touch.contact_id
        state = ZoneState.FREE if touch.zone is None else _state_of(touch.zone, self._state)
        level_db, felt_db = self._level_db.get(number, LOWEST_DB), self._felt_db.get(number, LOWEST_DB)
        return FingerPicture(number, touch.zone, state, touch.position_m, level_db, felt_db)

    def _zone(self, zone: int) -> ZonePicture:
        command = self._command
        promised = None if command is None else command.promised_db.get(zone)
        simulated = None if command is None or promised is None else command.simulated_db.get(zone)
        return ZonePicture(_state_of(zone, self._state), promised, simulated)


def _state_of(zone: int, state: int) -> int:
    """State of one zone, from engine.touch.finger_tracker.state_index."""
    return int(state // 3**zone % 3)


def _stages(values: Iterable[float]) -> Stages:
    a, b, c, d, e = (min(max(round(value), 0), 0xFFFF_FFFF) for value in values)
    return a, b, c, d, e
