"""One line of a table: the drive for one state of the zones at one level, and what it promises."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from engine.touch import ZoneState, state_index

DEFAULT_LEVEL_DB = 20.0
"""Sensation level where nothing else is asked for: plainly felt, 20 dB below full drive on the published bar."""

LEVEL_TOLERANCE_DB = 1e-3
"""A level within this of the wanted one is reached."""

Range = tuple[float, float]
"""Least and greatest, over the fingers that were looked at."""


@dataclass(frozen=True)
class ZonePromise:
    """What one zone does in steady state, the standard finger at the middle of every touched zone.

    Ranges: the same when the fingers lie elsewhere in their zones and are other fingers, within the device's spread.
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
    """Under the finger; None where there is none."""
    sensation_level_db: float | None
    """dB above the detection threshold, tones of different frequencies added in power; None: no finger."""
    sensation_level_range_db: Range | None


@dataclass(frozen=True)
class WorstCase:
    """The worst of each figure over the fingers that were looked at; each may come from another finger."""

    level_db: float
    """Weakest felt finger."""
    quiet_level_db: float | None
    """Strongest quiet finger; None: nothing is quiet."""
    contrast_db: float | None
    """Weakest felt over strongest quiet finger of the same sample."""
    localized_factor: float
    t90_s: float


@dataclass(frozen=True)
class Percentiles:
    """So many dB or less in 5, 50 and 95 % of the sampled cases."""

    low_db: float
    middle_db: float
    high_db: float

    def changed(self, change_db: float) -> "Percentiles":
        """All of them so much higher."""
        return Percentiles(self.low_db + change_db, self.middle_db + change_db, self.high_db + change_db)


@dataclass(frozen=True)
class EntrySpread:
    """How far what an entry promises is spread over the sampled cases; the table says what was sampled."""

    felt: Percentiles
    """Level of the weakest felt finger."""
    quiet: Percentiles | None
    """Level of the strongest quiet finger; None: nothing is quiet."""
    contrast: Percentiles | None
    """The one over the other, in the same case."""


@dataclass(frozen=True)
class Entry:
    """Per actuator: frequency, amplitude as a fraction of full scale, phase; and the figures the table promises."""

    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    zones: tuple[ZonePromise, ...]
    wanted_level_db: float
    """The level asked for; infinite: as much as full scale gives."""
    level_db: float
    """Sensation level of the weakest felt finger."""
    achieved: bool
    """False: no drive within full scale reaches the wanted level in every felt zone; this one comes nearest."""
    contrast_db: float | None
    """Weakest felt over strongest quiet finger, standard fingers; None: nothing is quiet."""
    expected_contrast_db: float | None
    """The same with each level averaged in power over the fingers looked at: what the search maximised."""
    localized_factor: float
    """Share of the felt zones together."""
    objective: str
    """What was maximised above the level: its name in precompute.entries.objective."""
    upper_bound: float
    """No drive of any kind does better: a share, or dB of expected contrast or of level, as the objective is."""
    optimality_gap_db: float
    """What the bound leaves open: 10 log10 of the power or share ratio."""
    t90_s: float
    """From rest: the time after which every felt finger's envelope stays within 10 % of its final value."""
    family: str
    """"single tone", "coherent", "two tones" or "several tones"."""
    limited_by: str
    worst_case: WorstCase
    spread: EntrySpread | None = None
    """None: the table was made before spreads were stated."""
    reached_db: float | None = None
    """What is compared with the wanted level: `level_db`, or in a table for the worst 5 % what 95 % of cases reach."""

    @property
    def states(self) -> tuple[ZoneState, ...]:
        """State of each zone."""
        return tuple(zone.state for zone in self.zones)

    @property
    def index(self) -> int:
        """The state as one number (engine.touch.finger_tracker.state_index)."""
        return state_index(self.states)


def played_at(entries: Sequence[Entry], level_db: float, amplitude_limit: float) -> Entry:
    """One state's `entries`, by rising level, at any level: a tabulated drive, louder or softer.

    The next lower entry where `amplitude_limit` lets it reach the level, since contrast only falls as the level rises;
    otherwise the next higher one.
    """
    higher = next(i for i, entry in enumerate(entries) if entry.wanted_level_db >= level_db)
    if entries[higher].wanted_level_db == level_db:
        return entries[higher]
    if higher > 0:
        louder = scaled_to(entries[higher - 1], level_db, amplitude_limit)
        if louder.achieved:
            return louder
    return scaled_to(entries[higher], level_db)


def scaled_to(entry: Entry, level_db: float, amplitude_limit: float = 0.0) -> Entry:
    """The entry played so that its weakest felt finger is at `level_db`; louder only up to `amplitude_limit`.

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
        spread=None if entry.spread is None else _changed(entry.spread, change_db),
        reached_db=reached_db + change_db,
    )


def _changed(spread: EntrySpread, change_db: float) -> EntrySpread:
    """Levels move, contrast stays."""
    quiet = None if spread.quiet is None else spread.quiet.changed(change_db)
    return EntrySpread(spread.felt.changed(change_db), quiet, spread.contrast)


def _scaled_zone(zone: ZonePromise, scale: float, change_db: float) -> ZonePromise:
    at_finger, level_db, range_db = (
        zone.acceleration_at_finger_m_per_s2,
        zone.sensation_level_db,
        zone.sensation_level_range_db,
    )
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
