"""The state of one run as a browser sees it: ring records and the moving bars to pictures, motions and sounds."""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from base.plain import to_plain
from base.points import is_within
from engine.device import Device
from engine.loop.observer import Stage
from engine.loop.ring import Record, RingCounters
from engine.table import Table
from engine.touch import Touch
from engine.touch.finger_tracker import ZoneFinder
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.emulator.synthesis import US_PER_S
from tactable.page.judged_commands import Command, CommandReader, time_of
from tactable.page.live_bar import LONGEST_STEP_S, RATE_HZ, BarLevels, LiveBar, PaperBar
from tactable.page.page_messages import (
    LOWEST_DB,
    Drive,
    FingerPicture,
    MadePicture,
    PaperPicture,
    Picture,
    Role,
    encode_motion,
    encode_sound,
)
from tactable.rig.promises import OtherBar, SampledPromises

CLICK_MOTION_S = 0.09  # length of the slowed moment of a click: the click, and the ringing after it
STEADY_MOTION_S = 0.04  # two periods of 60 Hz, twelve of 300 Hz
CAPTURE_AFTER_S = 0.4  # a command can be seen slowed and heard this long after it; a steady one is captured repeatedly
HEARD_S = 0.4  # long enough for a pitch; of the past that is kept (KEPT_S)
LOUDER_DB = 12.0  # distance of the wanted level from full scale in a sound
LOUDEST_LEVEL_DB = 40.0  # the wanted level that is assumed for a command at full scale
_MOTION_RATE_HZ = 3000  # ten moments in a period of 300 Hz
_FULL_SCALE = 32_767  # the greatest int16


class Capture:
    """Captures motions to be shown slowed and sounds to be heard: of a command, then of the newest that came."""

    def __init__(self) -> None:
        self._command: Command | None = None
        self._due_us, self._is_captured = math.inf, False
        self._sounds: dict[int, NDArray[np.int16]] = {}

    def begin_command(self, command: Command) -> None:
        """Wait for a command, unless another is waited for that was not captured yet."""
        if self._command is None or self._is_captured:
            self._command, self._due_us = command, command.at_us + CAPTURE_AFTER_S * US_PER_S
            self._is_captured = False

    def take_motion(self, bars: Sequence[LiveBar], touches: Sequence[Touch], newest: Command | None) -> list[bytes]:
        """The MOTION that is due, of bars that show the same moment; sounds are those of the first bar."""
        command, now_us = self._command, bars[0].now_us
        if command is None or now_us < self._due_us:
            return []
        is_click = command.drive is Drive.CLICK
        duration_s = CLICK_MOTION_S if is_click else STEADY_MOTION_S
        since_us = command.at_us if is_click else self._due_us - duration_s * US_PER_S
        every = RATE_HZ // _MOTION_RATE_HZ if is_click else RATE_HZ // _MOTION_RATE_HZ // 2
        contacts = {finger: number for number, finger in command.fingers.items()}
        places_m = enumerate(command.placement.position_m)
        finger_m = [bars[0].place_of(contacts.get(finger), at_m) for finger, at_m in places_m]
        moments = [bar.motion(since_us, duration_s, every, finger_m) for bar in bars]
        self._keep_sounds(command, bars[0], touches)
        self._due_us, self._is_captured = now_us + 1e6, True
        if newest is not None and newest is not command:
            self.begin_command(newest)
        elif now_us >= command.ended_us:
            self._command = None
        motions = [moment for moment in moments if moment is not None]
        if len(motions) < len(bars) or not motions[0].any():
            return []
        size = bars[0].moving.along, bars[0].moving.across
        return [encode_motion(np.stack(motions), size, every / RATE_HZ, command.number, is_click=is_click)]

    def _keep_sounds(self, command: Command, bar: LiveBar, touches: Sequence[Touch]) -> None:
        full_scale_db = LOUDER_DB + (command.wanted_db if math.isfinite(command.wanted_db) else LOUDEST_LEVEL_DB)
        per_threshold = _FULL_SCALE / 10 ** (full_scale_db / 20)
        for touch in touches:
            course = bar.felt(touch.contact_id)
            if course is not None:
                heard = course[-round(HEARD_S * RATE_HZ) :] * per_threshold
                self._sounds[touch.contact_id] = np.clip(np.rint(heard), -_FULL_SCALE, _FULL_SCALE).astype(np.int16)

    def sound(self, finger: int) -> bytes | None:
        """SOUND of the last captured command under a finger; None where the finger felt none."""
        samples = self._sounds.get(finger)
        return None if samples is None else encode_sound(finger, RATE_HZ, samples)


LATENCIES = 64  # of the newest commands, whose median is shown
LOST_S = 0.3  # a click that the firmware has not taken so long after it was written was refused as late
JUDGED_S = 0.3  # age of a command from which on the page says what was felt
_STAGES = len(Stage) - 1
_NO_COUNTERS = RingCounters(0, 0, 0, 0, 0, 0)
Stages = tuple[int, int, int, int, int]


def device_json(device: Device) -> dict[str, Any]:
    """The values of a device that the page draws, for JSON."""
    return {
        "name": device.name,
        "description": device.description,
        "corner_m": to_plain(device.surface.corner_m),
        "zones": to_plain(device.zones),
        "actuators": [
            {"name": each.name, "position_m": to_plain(each.position_m), "band_hz": list(each.band_hz)}
            for each in device.actuators
        ],
        "most": device.limits.amplitude,
        "estimates": len(device.estimated_values),
        "threshold": device.threshold.title,
        "spread": device.spread_text,
    }


class View:
    """The run of one table. Times are those of the device; `zero_ns` is host time at the device's zero.

    bar: moves as the firmware drives it. ours: its levels. paper: a second bar, which the rows of the table's sweep
    move. halvings: how many times the functions of the board's basis are halved.
    """

    def __init__(
        self,
        table: Table,
        bar: LiveBar,
        frequency_resolution_hz: float,
        *,
        paper: PaperBar | None = None,
        halvings: int = 0,
    ) -> None:
        self.table, self.bar, self.ours, self.paper = table, bar, BarLevels(bar), paper
        self.zero_ns = 0
        self.spreads: SampledPromises | None = None  # what sampled bars give, where it is known
        self._reader = CommandReader(table, frequency_resolution_hz, halvings=halvings)
        self.solved = self._reader.solved
        """The placements whose clicks were solved beside the run and played, in the order of their first play."""
        self._edges = ZoneFinder(table.device)
        self._touches: tuple[Touch, ...] = ()
        self._counters = _NO_COUNTERS
        self._latencies_ns: deque[list[int]] = deque(maxlen=LATENCIES)
        self._command: Command | None = None
        self._is_loaded = True
        self._capture = Capture()
        self._taken_us: dict[int, float] = {}  # by sequence number, when the firmware last took it

    def begin_at_rest(self, now_us: float) -> None:
        """Start at rest at this time, which is that of a device that has just booted."""
        self.bar.begin_at_rest(now_us)
        if self.paper is not None:
            self.paper.begin_at_rest(now_us)

    def read(self, records: Iterable[Record]) -> None:
        """Take records of the ring."""
        for record in records:
            if _is_beyond(record, self.table.device.surface.corner_m):
                continue  # the run played another table then
            self._touches, self._counters = record.touches, record.counters
            if record.drive_sequence is None:
                continue
            if all(record.stamps_ns):
                stages = zip(record.stamps_ns, record.stamps_ns[1:], strict=False)
                self._latencies_ns.append([later - earlier for earlier, later in stages])
            command = self._reader.command_of(record, self.zero_ns)
            if command is not None:
                self._begin(command)
            elif self._command is not None:
                at_us = time_of(record, self.zero_ns)
                self._command.ended_us = min(at_us, self._command.ended_us)
                if self.paper is not None:
                    self.paper.fall_silent(at_us)

    def _begin(self, command: Command) -> None:
        command.is_mixed = command.cuts(self._command)
        self._command = command
        self.ours.begin_command()
        if self.paper is not None:
            self.paper.play(command)
        self._capture.begin_command(command)

    def take_events(self, events: Sequence[DriveEvent]) -> None:
        """Take what the firmware drove."""
        self.bar.take_events(events)
        self._taken_us |= {event.sequence: event.device_time_us for event in events if event.sequence is not None}

    def move(self, until_us: float, *, is_loaded: bool, other: OtherBar | None = None) -> list[bytes]:
        """Advance the bars, which may be others than the table's; returns MOTION messages, to be shown slowed."""
        self._is_loaded, command, start_us = is_loaded, self._command, self.bar.now_us
        self.bar.become(other)
        if self.paper is not None:
            self.paper.levels.bar.become(other, self.bar)
        self.bar.touch(self._touches, is_loaded=is_loaded)
        if until_us - start_us > LONGEST_STEP_S * US_PER_S and command is not None:
            command.is_stalled |= start_us < command.ended_us
        self.ours.move_until(until_us, self._touches, command)
        bars = [self.bar]
        if self.paper is not None:
            self.paper.move_until(until_us, self._touches, command, is_loaded=is_loaded)
            bars.append(self.paper.levels.bar)
        self._find_spread(command)
        return self._capture.take_motion(bars, self._touches, command)

    def _find_spread(self, command: Command | None) -> None:
        """Compute what sampled bars give of a command, once, when it is judged: it takes some milliseconds."""
        if command is None or command.played is None or command.spread_db is not None or self.spreads is None:
            return
        if self.bar.now_us > command.at_us + JUDGED_S * US_PER_S:
            command.spread_db = self.spreads.of(command.placement, command.played)

    def sound(self, finger: int) -> bytes | None:
        """SOUND of the last captured command under a finger; None where the finger felt none."""
        return self._capture.sound(finger)

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
            is_late=command is not None and self._is_late(command),
            is_mixed=command is not None and command.is_mixed,
            fingers=tuple(self._finger(touch) for touch in self._touches),
            made=() if command is None else self._made(command),
            channels=() if command is None else command.channels,
            levels_db=self.ours.along_db,
            counted_db=self.ours.counted_db,
            rows=self.bar.field.across,
            paper=None if self.paper is None else self._paper(self.paper.levels),
        )

    def _is_late(self, command: Command) -> bool:
        """Whether what a command did cannot be judged; a steady drive that is there already causes no event."""
        if command.is_stalled or command.drive is not Drive.CLICK or command.sequence is None:
            return command.is_stalled
        # Sequence numbers come again after 256 commands.
        taken_us = self._taken_us.get(command.sequence, -math.inf)
        return taken_us < command.at_us - US_PER_S and self.bar.now_us > command.at_us + LOST_S * US_PER_S

    def _finger(self, touch: Touch) -> FingerPicture:
        number, command = touch.contact_id, self._command
        finger = None if command is None else command.fingers.get(number)
        role = Role.NONE if command is None or finger is None else command.role(finger)
        return FingerPicture(number, touch.zone, role, touch.position_m, *_levels_of(self.ours, number))

    def _made(self, command: Command) -> tuple[MadePicture, ...]:
        here = {touch.contact_id for touch in self._touches}
        numbers = {finger: number for number, finger in command.fingers.items() if number in here}
        fingers = len(command.placement.position_m)
        spread = [(None, None)] * fingers if command.spread_db is None else command.spread_db.T.tolist()
        return tuple(
            MadePicture(
                number=numbers.get(finger),
                zone=self._edges.zone_at(at_m),
                role=command.role(finger),
                position_m=at_m,
                promised_db=command.promised_db[finger],
                simulated_db=self.ours.simulated_db.get(finger),
                low_db=spread[finger][0],
                high_db=spread[finger][1],
            )
            for finger, at_m in enumerate(command.placement.position_m)
        )

    def _paper(self, levels: BarLevels) -> PaperPicture:
        made = () if self._command is None else self._command.placement.position_m
        return PaperPicture(
            fingers_db=tuple(_levels_of(levels, touch.contact_id) for touch in self._touches),
            simulated_db=tuple(levels.simulated_db.get(finger) for finger in range(len(made))),
            levels_db=levels.along_db,
            counted_db=levels.counted_db,
        )


def _is_beyond(record: Record, corner_m: complex) -> bool:
    """Whether a finger of a record is beyond the edges of a surface up to `corner_m`."""
    placed_m = () if record.placement is None else record.placement.position_m
    return not all(is_within(at_m, corner_m) for at_m in (*placed_m, *(touch.position_m for touch in record.touches)))


def _levels_of(levels: BarLevels, number: int) -> tuple[float, float]:
    """The present level of a contact, and the greatest since the last command."""
    return levels.present_db.get(number, LOWEST_DB), levels.felt_db.get(number, LOWEST_DB)


def _stages(values: Iterable[float]) -> Stages:
    a, b, c, d, e = (min(max(round(value), 0), 0xFFFF_FFFF) for value in values)
    return a, b, c, d, e
