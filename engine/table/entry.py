"""An entry of a table: the drive for one state of the zones at one level, and what the table promises of it."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, TypeVar

from engine.touch import ZoneState, state_index

DEFAULT_LEVEL_DB = 20.0
"""The default sensation level: plainly felt, and 20 dB below full drive on the published bar."""

LEVEL_TOLERANCE_DB = 1e-3
"""A level within this of the wanted one is reached."""

LONGEST_RISE_S = 10.0
"""No rise is followed for longer: this t90 stands for every longer one."""

Levels = TypeVar("Levels", bound=Any)  # a dataclass whose fields are all in dB
Range = tuple[float, float]
"""Least and greatest value over the sampled fingers."""


@dataclass(frozen=True)
class ZonePrediction:
    """Steady state of one zone, with a standard finger at the middle of every touched zone.

    Ranges are over sampled fingers, which lie elsewhere in their zones and differ within the device's spread.
    """

    name: str
    state: ZoneState
    share: float
    """Localized factor of the zone: its share of the kinetic energy."""
    share_range: Range
    peak_acceleration_m_per_s2: float
    peak_acceleration_range_m_per_s2: Range
    peak_position_m: float
    dead_acceleration_m_per_s2: float
    """Least acceleration in the zone, and where."""
    dead_position_m: float
    acceleration_at_finger_m_per_s2: float | None
    """Peak acceleration under the finger; None: no finger."""
    sensation_level_db: float | None
    """dB above the detection threshold, tones of different frequencies added in power; None: no finger."""
    sensation_level_range_db: Range | None


@dataclass(frozen=True)
class WorstCase:
    """The worst of each figure over the sampled fingers; each figure may come from another sample."""

    level_db: float
    """Weakest felt finger."""
    quiet_level_db: float | None
    """Strongest quiet finger; None: nothing is quiet."""
    contrast_db: float | None
    """Weakest felt over strongest quiet finger of the same sample."""
    localized_factor: float
    t90_s: float
    """LONGEST_RISE_S: longer than that."""


@dataclass(frozen=True)
class Percentiles:
    """5th, 50th and 95th percentile over the sampled cases, dB."""

    low_db: float
    middle_db: float
    high_db: float


@dataclass(frozen=True)
class EntrySpread:
    """How the figures of an entry are distributed over the sampled cases; the table says what was sampled."""

    felt: Percentiles
    """Level of the weakest felt finger."""
    quiet: Percentiles | None
    """Level of the strongest quiet finger; None: nothing is quiet."""
    contrast: Percentiles | None
    """Felt over quiet level of the same case."""


@dataclass(frozen=True)
class Entry:
    """Frequency, amplitude (fraction of full scale) and phase of each actuator, and the figures of this drive."""

    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    zones: tuple[ZonePrediction, ...]
    wanted_level_db: float
    """The level that is asked for; infinite: as much as full scale gives."""
    level_db: float
    """Sensation level of the weakest felt finger."""
    achieved: bool
    """False: no drive within full scale reaches the wanted level in every felt zone; this one comes nearest."""
    contrast_db: float | None
    """Weakest felt over strongest quiet finger, standard fingers; None: nothing is quiet."""
    expected_contrast_db: float | None
    """Contrast of the levels averaged in power over the sampled fingers: what the search maximises by default."""
    localized_factor: float
    """Share of the felt zones together."""
    objective: str
    """Name of the objective that was maximised (precompute.entries.objective)."""
    upper_bound: float
    """No drive of any kind does better: a share, or dB of expected contrast or of level, as the objective is."""
    optimality_gap_db: float
    """What the bound leaves open: 10 log10 of the power or share ratio."""
    t90_s: float
    """Time from rest after which the envelope under every felt finger stays within 10 % of its final value.

    LONGEST_RISE_S: longer than that.
    """
    family: str
    """"single tone", "coherent", "two tones" or "several tones"."""
    limited_by: str
    worst_case: WorstCase
    spread: EntrySpread | None = None
    """None in a table that was made before spreads were stated."""
    reached_db: float | None = None
    """The level that is compared with the wanted one: `level_db`, or the level that 95 % of the cases reach."""

    @property
    def states(self) -> tuple[ZoneState, ...]:
        """State of each zone."""
        return tuple(zone.state for zone in self.zones)

    @property
    def index(self) -> int:
        """The state as one number (engine.touch.finger_tracker.state_index)."""
        return state_index(self.states)


def played_at(entries: Sequence[Entry], level_db: float, amplitude_limit: float) -> Entry:
    """The entry of a state at any level: a tabulated drive, played louder or softer. `entries`: by rising level.

    It is the next lower entry where `amplitude_limit` lets it reach the level, since contrast only falls with rising
    level; otherwise the next higher one.
    """
    last = len(entries) - 1  # full scale in every table that was built
    higher = next((i for i, entry in enumerate(entries) if entry.wanted_level_db >= level_db), last)
    if entries[higher].wanted_level_db == level_db:
        return entries[higher]
    if higher > 0:
        louder = scaled_to(entries[higher - 1], level_db, amplitude_limit)
        if louder.achieved:
            return louder
    return scaled_to(entries[higher], level_db)


def scaled_to(entry: Entry, level_db: float, amplitude_limit: float = 0.0) -> Entry:
    """Scale the entry until its weakest felt finger is at `level_db`, with no amplitude above `amplitude_limit`.

    Every acceleration scales with the amplitude; shares, contrasts and rise times stay.
    """
    headroom_db = 20 * math.log10(max(1.0, amplitude_limit / max(entry.amplitudes)))
    reached_db = entry.level_db if entry.reached_db is None else entry.reached_db
    change_db = min(headroom_db, level_db - reached_db)
    scale = 10 ** (change_db / 20)
    worst = entry.worst_case
    quiet_db = None if worst.quiet_level_db is None else worst.quiet_level_db + change_db
    return replace(
        entry,
        amplitudes=tuple(amplitude * scale for amplitude in entry.amplitudes),
        zones=tuple(_scaled_zone(zone, scale, change_db) for zone in entry.zones),
        wanted_level_db=level_db,
        level_db=entry.level_db + change_db,
        achieved=math.isinf(level_db) or reached_db + change_db >= level_db - LEVEL_TOLERANCE_DB,
        worst_case=replace(worst, level_db=worst.level_db + change_db, quiet_level_db=quiet_db),
        spread=entry.spread and _shifted_spread(entry.spread, change_db),
        reached_db=reached_db + change_db,
    )


def _shifted_spread(spread: EntrySpread, change_db: float) -> EntrySpread:
    """Levels shift with the drive; the contrast between them stays."""
    return replace(
        spread, felt=shifted(spread.felt, change_db), quiet=spread.quiet and shifted(spread.quiet, change_db)
    )


def shifted(levels: Levels, change_db: float) -> Levels:
    """A dataclass of levels in dB, all of them raised by `change_db`."""
    raised: Levels = type(levels)(*(level_db + change_db for level_db in astuple(levels)))
    return raised


def _scaled_zone(zone: ZonePrediction, scale: float, change_db: float) -> ZonePrediction:
    at_finger, level_db = zone.acceleration_at_finger_m_per_s2, zone.sensation_level_db
    range_db = zone.sensation_level_range_db
    least, greatest = zone.peak_acceleration_range_m_per_s2
    return replace(
        zone,
        peak_acceleration_m_per_s2=zone.peak_acceleration_m_per_s2 * scale,
        peak_acceleration_range_m_per_s2=(least * scale, greatest * scale),
        dead_acceleration_m_per_s2=zone.dead_acceleration_m_per_s2 * scale,
        acceleration_at_finger_m_per_s2=None if at_finger is None else at_finger * scale,
        sensation_level_db=None if level_db is None else level_db + change_db,
        sensation_level_range_db=None if range_db is None else (range_db[0] + change_db, range_db[1] + change_db),
    )
