"""The moving surface of the page: drive events and finger positions to its acceleration, live. SIMULATED.

What is simulated, filtered by the threshold and kept are the accelerations of the modes, whatever is looked at. The
threshold filter is linear, so a level at any place follows from the filtered modes and the mode shapes there.
"""

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from base.arrays import Array, Field
from engine.device import Device, Finger
from engine.loop.ring import MOST_TOUCHES
from engine.table.best_rows import BestRows, combination_of
from engine.touch import Touch, ZoneState
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.synthesis import US_PER_S, Synthesis
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.model.transfers import threshold_filter
from precompute.model.transient import TransientPlant
from tactable.page.judged_commands import Command
from tactable.page.page_messages import LOWEST_DB, Drive
from tactable.rig.promises import OtherBar
from tactable.rig.ready import modes_of

RATE_HZ = 12_000  # 40 samples in a period of 300 Hz: straight lines between them cost 0.2 % of the amplitude
MOST_POINTS, MOST_MOVING = 1500, 420
"""Points of a field of levels, and of a field that is shown slowed: 6 and 12 mm apart on a tablet."""
_WHOLE = 400  # of a field of more points, every n-th sample is looked at. Under fingers all are.
KEPT_S = 1.0  # length of the past that can be seen slowed, and heard
POWER_S = 0.1  # averaging time of the level of a steady drive
LONGEST_STEP_S = KEPT_S
"""After a longer stall the missed time is left out: the past that is kept must hold a whole step."""
STILL_M = 2e-4  # a smaller move of a finger leaves the plant unchanged
MOVED_US = 50_000
"""Shortest time between two updates of the modes under a moving finger: to compute those of a plate takes as long."""
_SMOOTH = 160
"""Spectra have a multiple of this length: of a power of two, columns compete for the same lines of the cache."""
STEP_US = 30_000  # the second bar takes every second step of the first, which halves what it costs
_SILENT = 10 ** (LOWEST_DB / 20)  # what the page shows as nothing


class Levels(NamedTuple):
    """Levels in dB above the detection threshold, at least LOWEST_DB: (point,) in the field, and by finger."""

    field_db: Array
    finger_db: dict[int, float]


class Moved(NamedTuple):
    """The levels of one stretch of time: the greatest, and the mean power of all tones."""

    peak: Levels
    power: Levels


class _RollingBuffer:
    """Keeps the last `kept` samples (time, column) in bounded memory; they are zeros at first."""

    def __init__(self, kept: int, columns: int) -> None:
        self.kept = kept
        # Twice as long as kept: samples are moved to the front only when the end is reached, once in `kept` samples.
        self._values = np.zeros((2 * kept, columns))
        self._end = kept

    def push(self, samples: Array) -> None:
        """Append samples (time, column); the oldest are dropped."""
        samples = samples[-self.kept :]
        if self._end + len(samples) > len(self._values):
            rest = self.kept - len(samples)
            self._values[:rest] = self._values[self._end - rest : self._end].copy()
            self._end = rest
        self._values[self._end : self._end + len(samples)] = samples
        self._end += len(samples)

    def last(self, count: int) -> Array:
        """A view of the newest `count` samples, at most `kept`, valid until the next push."""
        return self._values[self._end - count : self._end]


class _ModalPlant(TransientPlant):
    """The plant whose "points" are the modes of its basis."""

    def look_at(self, position_m: object) -> None:  # noqa: ARG002  # the points of the base class
        modes = len(self.basis.square_omega)
        self.position_m, self._shape = np.zeros(modes), np.eye(modes)


class _Modes:
    """The modes of a device, and its damped modes under fingers, of which the last two are kept."""

    def __init__(self, device: Device) -> None:
        self.basis = compute_basis(assemble(device), modes_of(device))
        self.under = lru_cache(2)(partial(compute_modal_model, self.basis))


class LiveBar:
    """The time-domain plant of a device, on the firmware's time: `take_events`, then `move_until`.

    field, moving: the points of levels, and of what is shown slowed. twin: another bar of the device, with the same
    fingers: damped modes are computed once for both.
    """

    def __init__(self, device: Device, twin: "LiveBar | None" = None) -> None:
        self.device = device
        self.now_us = 0.0
        corner_m = device.surface.corner_m
        self.field, self.moving = Field.of(corner_m, MOST_POINTS), Field.of(corner_m, MOST_MOVING)
        self._modes: _Modes = _Modes(device) if twin is None else twin._modes
        self._other: OtherBar | None = None
        self._look_at_modes()
        self._every = 1 + self.field.count // _WHOLE
        self._taps = threshold_filter(device.threshold, RATE_HZ)
        silent = tuple(ChannelTarget(0.0, 0.0, None) for _ in device.actuators)
        self._silence = DriveEvent(0, Cause.NEW_SESSION, None, device.limits.slew_per_s, silent)
        self._synthesis = self._silent_synthesis()
        self._fingers: tuple[Touch, ...] = ()
        self._is_loaded = True
        self._heard = dict[int, tuple[float, Array]]()
        """By finger: since when it is on the bar, and the mode shapes (mode,) at its last position; newest last.

        A lifted finger is kept while there is room.
        """
        self._rest()

    def _look_at_modes(self) -> None:
        self._grid, self._moving = (self._modes.basis.at(each.position_m) for each in (self.field, self.moving))

    def become(self, other: OtherBar | None, twin: "LiveBar | None" = None) -> None:
        """Be another bar from now on, at rest, with its fingers; None: the table's. twin: one that is it already."""
        if other is self._other:
            return
        self._other = other
        device = self.device if other is None else other.device
        self._modes = _Modes(device) if twin is None else twin._modes
        self._look_at_modes()
        self._heard.clear()
        self._rest()

    def place_of(self, contact: int | None, at_m: complex) -> complex:
        """Where the finger of a contact is that seems to be at `at_m`."""
        return at_m if self._other is None or contact is None else self._other.finger_of(contact, at_m)[0]

    def begin_at_rest(self, now_us: float) -> None:
        """Start at rest at this time, which is that of a device that has just booted."""
        self._synthesis, self.now_us = self._silent_synthesis(), now_us
        self._rest()

    def _silent_synthesis(self) -> Synthesis:
        synthesis = Synthesis()
        synthesis.take_events([self._silence])
        return synthesis

    def _rest(self) -> None:
        """Put the bar at rest and forget the past."""
        kept, modes = round(KEPT_S * RATE_HZ), self._grid.shape[1]
        self._motion, self._weighted = _RollingBuffer(kept, modes), _RollingBuffer(kept, modes)
        self._unweighted = np.zeros((len(self._taps) - 1, modes))
        self._loud_us = -np.inf
        self._plant = _ModalPlant(self._modes.basis, np.zeros(0), RATE_HZ)
        self._loads, self._loaded_us = dict[int, tuple[complex, Finger]](), self.now_us
        self._place()

    def take_events(self, events: Sequence[DriveEvent]) -> None:
        """Take drive events in the order of their times."""
        self._synthesis.take_events(events)

    def touch(self, fingers: Sequence[Touch], *, is_loaded: bool) -> None:
        """Set the fingers, at most as many as a ring record holds; they load the bar, or only feel it."""
        is_still = is_loaded == self._is_loaded and len(fingers) == len(self._fingers)
        if is_still and all(
            new.contact_id == old.contact_id and abs(new.position_m - old.position_m) < STILL_M
            for new, old in zip(fingers, self._fingers, strict=True)
        ):
            return
        self._fingers, self._is_loaded = tuple(fingers), is_loaded
        self._place()

    def _place(self) -> None:
        places_m = [self.place_of(finger.contact_id, finger.position_m) for finger in self._fingers]
        self._rows = np.concatenate([self._grid, self._modes.basis.at(np.array(places_m))])
        for finger, row in zip(self._fingers, self._rows[self.field.count :], strict=True):
            since_us, _ = self._heard.pop(finger.contact_id, (self.now_us, row))
            self._heard[finger.contact_id] = since_us, row
        while len(self._heard) > MOST_TOUCHES:
            del self._heard[next(iter(self._heard))]

    def _load(self, at_us: float) -> None:
        """Let the fingers load the plant: at once where there are others, now and then where they only move."""
        loads = {finger.contact_id: self._load_of(finger) for finger in self._fingers if self._is_loaded}
        if loads == self._loads or (loads.keys() == self._loads.keys() and at_us < self._loaded_us + MOVED_US):
            return
        self._plant.take_model(self._modes.under(tuple(loads.values())))
        self._loads, self._loaded_us = loads, at_us

    def _load_of(self, finger: Touch) -> tuple[complex, Finger]:
        if self._other is None:
            return finger.position_m, self.device.finger
        return self._other.finger_of(finger.contact_id, finger.position_m)

    def move_until(self, until_us: float) -> Moved | None:
        """Simulate until then; None while nothing moves."""
        if until_us - self.now_us > LONGEST_STEP_S * US_PER_S:
            self.now_us = until_us - LONGEST_STEP_S * US_PER_S
            self._rest()
        start_us, self.now_us = self.now_us, max(self.now_us, until_us)
        self._synthesis.forget(start_us)
        displacement = self._synthesis.displacements(start_us, self.now_us, RATE_HZ)
        is_idle = not displacement.any() and start_us - self._loud_us > US_PER_S * len(self._taps) / RATE_HZ
        if is_idle or not len(displacement):
            silence = np.zeros((len(displacement), self._grid.shape[1]))
            self._motion.push(silence)
            self._weighted.push(silence)
            return None
        self._load(start_us)
        acceleration = self._plant.accelerate(displacement)
        self._motion.push(acceleration)
        self._weighted.push(self._weigh(acceleration))
        newest = self._greatest(len(displacement))
        if newest.max() > _SILENT:
            self._loud_us = self.now_us
        past = self._weighted.last(round(POWER_S * RATE_HZ))
        # The mean of a square under a shape is a quadratic form of the modes' covariance.
        power = np.sqrt(np.maximum(2 * np.einsum("pm,pm->p", self._rows @ (past.T @ past / len(past)), self._rows), 0))
        return Moved(self._levels_of(newest), self._levels_of(power))

    def _levels_of(self, ratio: Array) -> Levels:
        """The levels of ratios in the field, then under the fingers."""
        level_db, numbers = decibels(ratio), [finger.contact_id for finger in self._fingers]
        under_db = level_db[self.field.count :].tolist()
        return Levels(level_db[: self.field.count], dict(zip(numbers, under_db, strict=True)))

    def _greatest(self, count: int) -> Array:
        """Greatest acceleration over threshold in the newest samples: in the field, then under the fingers."""
        newest, field = self._weighted.last(count).T, self.field.count
        parts = self._rows[:field] @ newest[:, :: self._every], self._rows[field:] @ newest
        return np.concatenate([abs(part).max(axis=1, initial=0.0) for part in parts])

    def _weigh(self, acceleration: Array) -> Array:
        """Filter by the detection threshold (time, mode); the past of the filter is carried over."""
        course = np.concatenate([self._unweighted, acceleration])
        self._unweighted = course[-len(self._unweighted) :].copy()
        count = -(-len(course) // _SMOOTH) * _SMOOTH
        spectrum = np.fft.rfft(course, count, axis=0) * np.fft.rfft(self._taps, count)[:, None]
        # The circular convolution wraps around into the past, which is cut off.
        weighted: Array = np.fft.irfft(spectrum, count, axis=0)[len(self._unweighted) : len(course)]
        return weighted

    def greatest_since(self, since_us: float) -> Levels:
        """The greatest levels since a past moment; those of the fingers are at their present positions."""
        passed = min(max(_sample_at(self.now_us) - _sample_at(since_us), 0), self._weighted.kept)
        return self._levels_of(self._greatest(passed))

    def motion(self, since_us: float, duration_s: float, every: int, finger_m: Sequence[complex]) -> Array | None:
        """Acceleration (step, point and finger) of a moment, each `every`-th sample; None before its end, or late."""
        passed, count = _sample_at(self.now_us) - _sample_at(since_us), round(duration_s * RATE_HZ)
        if not count <= passed <= self._motion.kept:
            return None
        rows = np.concatenate([self._moving, self._modes.basis.at(np.array(finger_m))])
        acceleration: Array = self._motion.last(passed)[:count:every] @ rows.T
        return acceleration

    def felt(self, number: int) -> Array | None:
        """Acceleration over threshold (time,) under a finger in the last KEPT_S; None for an unknown finger.

        It is that at the finger's last position, and 0 before the finger came.
        """
        if number not in self._heard:
            return None
        since_us, row = self._heard[number]
        course: Array = self._weighted.last(self._weighted.kept) @ row
        since = len(course) - (_sample_at(self.now_us) - _sample_at(since_us))
        course[: max(since, 0)] = 0.0
        return course


def _sample_at(time_us: float) -> int:
    """Number of the first sample from a time on, as `synthesise` counts them."""
    return math.ceil(time_us * RATE_HZ / US_PER_S)


def decibels(ratio: Array) -> Array:
    """Decibels of amplitude ratios, at least LOWEST_DB."""
    level_db: Array = 20 * np.log10(np.maximum(ratio, _SILENT))
    return level_db


class BarLevels:
    """A bar and its levels. A click counts by its greatest level since it began, a steady drive by its present one."""

    def __init__(self, bar: LiveBar) -> None:
        self.bar = bar
        self._nothing_db: Array = np.full(bar.field.count, LOWEST_DB)
        self.along_db = self._nothing_db  # shape (point,): the present levels in the field
        self.counted_db = self._nothing_db  # shape (point,): the levels that count for the last command
        self.present_db = dict[int, float]()  # the present level, by contact
        self.felt_db = dict[int, float]()  # the greatest level since the last command, by contact
        self.simulated_db = dict[int, float]()  # the level that counts, by finger of the last command's placement
        self.is_moving = False

    def begin_command(self) -> None:
        """Forget what counted for the command before."""
        self.counted_db = self._nothing_db
        self.felt_db, self.simulated_db = {}, {}

    def move_until(self, until_us: float, touches: Sequence[Touch], command: Command | None) -> None:
        """Let the bar move until then, and take its levels for the command."""
        start_us = self.bar.now_us
        moved = self.bar.move_until(until_us)
        self.is_moving = moved is not None
        is_steady = command is not None and command.drive is Drive.STEADY
        if moved is None or command is None:
            self.along_db, self.present_db = self._nothing_db, {}
            self.counted_db = self.along_db if is_steady else self.counted_db
            return
        self.along_db = moved.peak.field_db
        # After a stall one step may hold several commands: what was before the last one is not that one's.
        counted_db, felt_db = self.bar.greatest_since(max(command.at_us, start_us))
        self.counted_db = moved.power.field_db if is_steady else np.maximum(self.counted_db, counted_db)
        self.present_db = (moved.power if is_steady else moved.peak).finger_db
        is_over = is_steady and self.bar.now_us > command.ended_us
        for touch in touches:
            number = touch.contact_id
            level_db = self.present_db.get(number, LOWEST_DB)
            now_db = level_db if is_steady else felt_db.get(number, LOWEST_DB)
            self.felt_db[number] = max(now_db, self.felt_db.get(number, LOWEST_DB))
            finger = command.fingers.get(number)
            if finger is not None and not is_over:
                self.simulated_db[finger] = level_db if is_steady else self.felt_db[number]


class PaperBar:
    """The same bar with the same fingers, on the time of the first, driven by the paper's method.

    The paper chooses a drive for zones, on the bar without fingers: the greatest share of the energy in the zones where
    fingers are to feel, paper eq. (11). That is the row of the table's sweep that a run with drives of zones plays. The
    paper has no clicks. Beside a click its row is switched on for as long as the click lasts, within the slew of the
    device.
    """

    def __init__(self, first: LiveBar, rows: BestRows) -> None:
        device = first.device
        self.levels = BarLevels(LiveBar(device, first))
        self.rows = rows
        self._device, self._slew_per_s = device, device.limits.slew_per_s
        self._silent = tuple(ChannelTarget(0.0, 0.0, None) for _ in device.actuators)
        self._last_us, self._ends_us = 0.0, math.inf

    def begin_at_rest(self, now_us: float) -> None:
        """Start at rest, as the other bar does."""
        self.levels.bar.begin_at_rest(now_us)
        self._last_us, self._ends_us = now_us, math.inf

    def play(self, command: Command) -> None:
        """Play the row for the zones of a command's felt fingers, for as long as that lasts."""
        self._end_by(command.at_us)
        self.levels.begin_command()
        states = enumerate(command.placement.zone_states(self._device))
        felt = combination_of(zone for zone, state in states if state is ZoneState.FELT)
        row = self.rows.at(felt, command.wanted_db)
        if row is None:
            self.fall_silent(command.at_us)
            return
        drive = zip(row.frequencies_hz, row.amplitudes, row.phases_rad, strict=True)
        self._take(command.at_us, tuple(ChannelTarget(*channel) for channel in drive))
        fall_s = max(row.amplitudes) / self._slew_per_s
        self._ends_us = self._last_us + max(command.length_s - fall_s, 0.0) * US_PER_S

    def fall_silent(self, at_us: float) -> None:
        """End what plays."""
        self._take(at_us, self._silent)
        self._ends_us = math.inf

    def move_until(
        self, until_us: float, touches: Sequence[Touch], command: Command | None, *, is_loaded: bool
    ) -> None:
        """Let the bar move until then, with the fingers of the first bar; less than STEP_US are left for later."""
        if 0 <= until_us - self.levels.bar.now_us < STEP_US:
            return
        self._end_by(until_us)
        self.levels.bar.touch(touches, is_loaded=is_loaded)
        self.levels.move_until(until_us, touches, command)

    def _end_by(self, until_us: float) -> None:
        """End a drive in place of a click that is over by then."""
        if self._ends_us <= until_us:
            self.fall_silent(self._ends_us)

    def _take(self, at_us: float, channels: tuple[ChannelTarget, ...]) -> None:
        # A record may be read after the time of its command: what the bar did until now stays as it was.
        self._last_us = max(at_us, self._last_us, self.levels.bar.now_us)
        event = DriveEvent(math.ceil(self._last_us), Cause.SET, None, self._slew_per_s, channels)
        self.levels.bar.take_events([event])
