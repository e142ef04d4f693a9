"""One state and one length to a waveform: searched, trimmed on other plants, as loud as is wanted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.zones import ZoneState
from precompute.click_basis import LOOK_RATE_HZ, PLAY_RATE_HZ, RING_S, Responses, Tones, independent, make_tones
from precompute.click_judge import decibels
from precompute.click_options import ClickOptions
from precompute.click_program import Optimum, Program
from precompute.click_search import Aim, Strongest, search_click
from precompute.promise import States, touched_zones

Array = NDArray[np.float64]

_CLOSE_DB = 0.05
_TRIMS = 3
_MOST_EXCESS_DB = 40.0
_HALVINGS = 10


@dataclass(frozen=True)
class Plants:
    """Responses of the plants that a click is optimised over, trimmed on, and judged by."""

    optimised: Responses
    trimmed: Responses
    judged: Responses


@dataclass(frozen=True)
class Design:
    """Base displacements (actuator, time) as fractions of full scale, and what is known of them as an optimum.

    achieved: in the trimmed plants both levels are as asked. bound_db: no weights of the tones do better at any aim
    that was tried; gap_db: what is left to it.
    """

    waveform: Array
    achieved: bool
    bound_db: float
    gap_db: float


class Designer:
    """Designs the click of one state and length."""

    def __init__(self, device: Device, options: ClickOptions, plants: Plants, states: States, length_s: float) -> None:
        self._options, self._length_s, self._trim_plants = options, length_s, plants.trimmed
        self.felt, self.quiet = fingers_of(states, ZoneState.FELT), fingers_of(states, ZoneState.QUIET)
        self._tones = independent(make_tones(device, length_s, options.crowding))
        played = plants.optimised.play_each(self._tones)[:, :, : round((length_s + RING_S) * LOOK_RATE_HZ)]
        self._course = played[:, self.felt].mean(axis=0)
        watched = [played[:, self.quiet].reshape(-1, *played.shape[2:])]
        if options.brake_s is not None:
            late = played[:, self.felt, round(options.brake_s * LOOK_RATE_HZ) :]
            padded = np.zeros((late.shape[0] * late.shape[1], *played.shape[2:]))
            padded[:, -late.shape[2] :] = late.reshape(-1, *late.shape[2:])
            watched.append(padded)
        self._amplitude = device.limits.amplitude
        kept = drive_rows(self._tones, self._amplitude, options.slew_per_s)
        self._program = Program(kept, np.concatenate(watched), len(self.felt))

    def design(self) -> Design:
        """As strong as can be within the quiet level, or as wanted."""
        limit_db = self._options.quiet_db
        strongest = self._search(limit_db)
        if self.quiet:
            limit_db, _ = self._trim(strongest, limit_db)
            strongest = self._search(limit_db)
            trimmed_db, optimum = self._trim(strongest, limit_db)
            # No bound grows faster than the limit.
            bound = strongest.bound * max(1.0, _factor(trimmed_db - limit_db))
            strongest = Strongest(strongest.aim, optimum, max(bound, optimum.bound))
        return self._settle(strongest)

    def fit(self, waveform: Array) -> Design:
        """Any waveform, as loud as the drive's amplitude and the quiet level allow, or as wanted; the bound is none."""
        full = waveform * (self._amplitude / np.abs(waveform).max())
        return self._as_wanted(full * _factor(self._allowed_db(full)), np.inf, np.inf)

    def least_violation(self) -> Design | None:
        """The least quiet level above the one asked for at which the wanted level is reached; the bound is none.

        None where the drive alone does not reach it.
        """
        wanted_db, aim = self._options.wanted_db, self._search(self._options.quiet_db).aim
        assert wanted_db is not None  # nothing else can be out of reach
        low_db, high_db = self._options.quiet_db, self._options.quiet_db + _MOST_EXCESS_DB
        for _ in range(_HALVINGS):
            middle_db = (low_db + high_db) / 2
            reached = self._felt_db(self._tones.waveform(self._maximise(aim, middle_db).weight)) >= wanted_db
            low_db, high_db = (low_db, middle_db) if reached else (middle_db, high_db)
        waveform = self._tones.waveform(self._maximise(aim, high_db).weight)
        spare_db = self._felt_db(waveform) - wanted_db
        if spare_db < 0:
            return None
        waveform *= _factor(-spare_db)
        return Design(waveform, achieved=False, bound_db=np.inf, gap_db=np.inf)

    def _search(self, limit_db: float) -> Strongest:
        """Weights are divided by the limit: the program's own is 1, and what gives is the room of the drive."""
        limit = _factor(limit_db)
        self._program.set_room(1 / limit)
        return search_click(self._program, self._course, self._length_s).scaled(limit)

    def _maximise(self, aim: Aim, limit_db: float) -> Optimum:
        limit = _factor(limit_db)
        self._program.set_room(1 / limit)
        return self._program.maximise(aim.rows(self._course)).scaled(limit)

    def _trim(self, strongest: Strongest, limit_db: float) -> tuple[float, Optimum]:
        """The limit in the optimised plants with which 95 % of the trimmed ones keep to the quiet level."""
        optimum = strongest.optimum
        for _ in range(_TRIMS):
            over_db = self._quiet_db(self._tones.waveform(optimum.weight)) - self._options.quiet_db
            if abs(over_db) < _CLOSE_DB:
                break
            limit_db -= over_db
            optimum = self._maximise(strongest.aim, limit_db)
        return limit_db, optimum

    def _settle(self, strongest: Strongest) -> Design:
        waveform = self._tones.waveform(strongest.optimum.weight)
        change_db = self._allowed_db(waveform)
        bound_db = float(decibels(strongest.bound))
        gap_db = bound_db - float(decibels(strongest.optimum.value)) - change_db
        return self._as_wanted(waveform * _factor(change_db), bound_db, gap_db)

    def _allowed_db(self, waveform: Array) -> float:
        """The change, not above 0, with which 95 % of the trimmed plants keep to the quiet level."""
        return min(0.0, self._options.quiet_db - self._quiet_db(waveform)) if self.quiet else 0.0

    def _as_wanted(self, waveform: Array, bound_db: float, gap_db: float) -> Design:
        felt_db, wanted_db = self._felt_db(waveform), self._options.wanted_db
        if wanted_db is None:
            return Design(waveform, True, bound_db, gap_db)
        return Design(waveform * _factor(min(0.0, wanted_db - felt_db)), felt_db >= wanted_db, bound_db, gap_db)

    def _felt_db(self, waveform: Array) -> float:
        """What the weakest felt finger exceeds in 95 % of the trimmed plants."""
        peak = np.abs(self._trim_plants.play(waveform))[1:].max(axis=2)
        return float(np.percentile(decibels(peak[:, self.felt].min(axis=1)), 5))

    def _quiet_db(self, waveform: Array) -> float:
        """What the strongest quiet finger keeps to in 95 % of the trimmed plants."""
        peak = np.abs(self._trim_plants.play(waveform))[1:].max(axis=2)
        return float(np.percentile(decibels(peak[:, self.quiet].max(axis=1)), 95))


def fingers_of(states: States, kind: ZoneState) -> list[int]:
    """Which of the fingers, in the order of their zones, lie in zones of that state."""
    return [finger for finger, zone in enumerate(touched_zones(states)) if states[zone] is kind]


def drive_rows(tones: Tones, amplitude: float, slew_per_s: float | None) -> Array:
    """Rows (row, tone) that are within 1 where every displacement is within the amplitude and the slew."""
    actuators: Sequence[int] = np.unique(tones.actuator).tolist()
    rows = list[Array]()
    for actuator in actuators:
        wave = (tones.wave * (tones.actuator == actuator)[:, None]).T
        rows.append(wave[1:-1] / amplitude)
        if slew_per_s is not None:
            rows.append(np.diff(wave, axis=0) * PLAY_RATE_HZ / slew_per_s)
    return np.concatenate(rows)


def _factor(level_db: float) -> float:
    return float(10 ** (level_db / 20))
