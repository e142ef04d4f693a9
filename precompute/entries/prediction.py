"""The entry of a drive: its figures scaled to a level, each with its range over the sampled cases."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.table import Entry
from engine.table.entry import LEVEL_TOLERANCE_DB, EntrySpread, Percentiles, WorstCase, ZonePrediction
from engine.touch import ZoneState
from precompute.entries.found_drive import FoundDrive
from precompute.model.frequencies import FREQUENCY_STEP_HZ
from precompute.predict.performance import DriveFigures

Array = NDArray[np.float64]
States = tuple[ZoneState, ...]

SHARES = ("localized factor", "fair share", "paper")
"""Objectives whose value and bound are shares; the others' are in dB."""
PERCENTS = (5, 50, 95)


class MadeFor(StrEnum):
    """What the level and the contrast of an entry are to hold for."""

    MEAN = "mean"
    """The bar as it is described, or as it was fitted, and standard fingers."""
    WORST = "worst"
    """All but the worst 5 % of the sampled cases."""


_FULL = 1 - 1e-3
_AT_LEVEL_DB = 0.01


@dataclass(frozen=True)
class Candidate:
    """A drive chosen for a state by an objective, with the bound on it, its figures at full scale and its rise times.

    rise_s (case,): of the slowest felt finger, the standard case first. sampled (case, finger): power over threshold
    at full scale in the sampled cases: the sampled fingers, each on a bar of its own where a calibration left some.
    """

    states: States
    objective: str
    drive: FoundDrive
    bound: float
    figures: DriveFigures
    rise_s: Array
    sampled: Array

    @property
    def touched(self) -> tuple[int, ...]:
        """Indices of the zones that have a finger."""
        return touched_zones(self.states)

    def fingers(self, kind: ZoneState) -> list[int]:
        """Indices of the fingers that lie in zones of this state."""
        return [finger for finger, zone in enumerate(self.touched) if self.states[zone] is kind]

    @property
    def full_level_db(self) -> float:
        """Sensation level of the weakest felt standard finger at full scale."""
        return _db(float(self.figures.power[0, self.fingers(ZoneState.FELT)].min()))

    @property
    def low_level_db(self) -> float:
        """Level of the weakest felt finger at full scale that 95 % of the sampled cases reach."""
        return self._spread.felt.low_db

    @property
    def low_merit(self) -> float:
        """Contrast in dB that 95 % of the sampled cases reach; with nothing quiet, the share of the felt zones."""
        if self._spread.contrast is not None:
            return self._spread.contrast.low_db
        felt = [self.touched[finger] for finger in self.fingers(ZoneState.FELT)]
        return float(np.percentile(self.figures.share[1:, felt].sum(axis=1), PERCENTS[0]))

    @property
    def _spread(self) -> EntrySpread:
        return _spread(self.sampled, self.fingers(ZoneState.FELT), self.fingers(ZoneState.QUIET), 0.0)


def touched_zones(states: States) -> tuple[int, ...]:
    """Indices of the zones that have a finger."""
    return tuple(zone for zone, state in enumerate(states) if state is not ZoneState.FREE)


def make_entry(device: Device, candidate: Candidate, wanted_level_db: float, made_for: MadeFor = MadeFor.MEAN) -> Entry:
    """The entry of a candidate at a level; where full scale does not reach it, at full scale."""
    full_level_db = candidate.full_level_db if made_for is MadeFor.MEAN else candidate.low_level_db
    limit, drive, figures = device.limits.amplitude, candidate.drive, candidate.figures
    change_db = min(0.0, wanted_level_db - full_level_db)
    amplitude = drive.amplitude * 10 ** (change_db / 20) * limit
    level_db = 10 * np.log10(np.maximum(figures.power, 1e-30)) + change_db
    felt, quiet = candidate.fingers(ZoneState.FELT), candidate.fingers(ZoneState.QUIET)
    weakest, strongest = level_db[:, felt].min(axis=1), level_db[:, quiet].max(axis=1, initial=-np.inf)
    felt_zones = [candidate.touched[finger] for finger in felt]
    bound = max(candidate.bound, drive.value)
    if candidate.objective in SHARES and np.isfinite(bound):
        bound = min(bound, 1.0)  # interpolated between frequencies, a share may pass 1 by 1e-4
    # Values of the search are for amplitudes up to 1; a level scales with the power that the limit leaves.
    bound_db = _db(bound) + (20 * np.log10(limit) if candidate.objective == "level" else 0.0)
    return Entry(
        frequencies_hz=tuple(drive.frequency_hz.tolist()),
        amplitudes=tuple(np.minimum(abs(amplitude), limit).tolist()),
        phases_rad=tuple(np.angle(amplitude).tolist()),
        zones=tuple(
            _predict_zone(device, candidate, zone, change_db, level_db) for zone in range(len(candidate.states))
        ),
        wanted_level_db=wanted_level_db,
        level_db=float(weakest[0]),
        reached_db=full_level_db + change_db,
        achieved=bool(np.isinf(wanted_level_db) or full_level_db >= wanted_level_db - LEVEL_TOLERANCE_DB),
        contrast_db=float(weakest[0] - strongest[0]) if quiet else None,
        expected_contrast_db=_expected_contrast_db(figures, felt, quiet),
        localized_factor=float(figures.standard.share[felt_zones].sum()),
        objective=candidate.objective,
        upper_bound=bound if candidate.objective in SHARES else bound_db,
        optimality_gap_db=_db(max(bound / drive.value, 1.0)),
        t90_s=float(candidate.rise_s[0]),
        family=drive.family,
        limited_by=_limited_by(device, candidate, np.abs(amplitude), wanted_level_db, full_level_db - wanted_level_db),
        worst_case=WorstCase(
            level_db=float(weakest.min()),
            quiet_level_db=float(strongest.max()) if quiet else None,
            contrast_db=float((weakest - strongest).min()) if quiet else None,
            localized_factor=float(figures.share[:, felt_zones].sum(axis=1).min()),
            t90_s=float(candidate.rise_s.max()),
        ),
        spread=_spread(candidate.sampled, felt, quiet, change_db),
    )


def objective_value(entry: Entry) -> float | None:
    """What the drive reaches of its objective, in the unit of the bound (a share, or dB); None where none is claimed.

    "contrast" is the expected contrast, "level" the level; "standard contrast" counts its quiet floor.
    """
    if np.isinf(entry.upper_bound):
        return None
    if entry.objective in SHARES:
        return float(entry.upper_bound * 10 ** (-entry.optimality_gap_db / 10))
    return entry.upper_bound - entry.optimality_gap_db


def _spread(power: Array, felt: list[int], quiet: list[int], change_db: float) -> EntrySpread:
    level_db = 10 * np.log10(np.maximum(power, 1e-30)) + change_db
    weakest, strongest = level_db[:, felt].min(axis=1), level_db[:, quiet].max(axis=1, initial=-np.inf)
    return EntrySpread(
        felt=_percentiles(weakest),
        quiet=_percentiles(strongest) if quiet else None,
        contrast=_percentiles(weakest - strongest) if quiet else None,
    )


def _percentiles(level_db: Array) -> Percentiles:
    return Percentiles(*np.percentile(level_db, PERCENTS).tolist())


def _predict_zone(device: Device, candidate: Candidate, zone: int, change_db: float, level_db: Array) -> ZonePrediction:
    standard, figures, scale = candidate.figures.standard, candidate.figures, 10 ** (change_db / 20)
    finger = candidate.touched.index(zone) if zone in candidate.touched else None
    # The standard peak is interpolated between places; the peaks of the range are not.
    own_peak = float(standard.peak[zone])
    peak = np.append(figures.peak[:, zone], own_peak)
    return ZonePrediction(
        name=device.zones[zone].name,
        state=candidate.states[zone],
        share=float(standard.share[zone]),
        share_range=_range(figures.share[:, zone]),
        peak_acceleration_m_per_s2=own_peak * scale,
        peak_acceleration_range_m_per_s2=_range(peak * scale),
        peak_position_m=float(standard.peak_position_m[zone]),
        dead_acceleration_m_per_s2=float(standard.dead[zone]) * scale,
        dead_position_m=float(standard.dead_position_m[zone]),
        acceleration_at_finger_m_per_s2=None if finger is None else float(figures.acceleration[0, finger]) * scale,
        sensation_level_db=None if finger is None else float(level_db[0, finger]),
        sensation_level_range_db=None if finger is None else _range(level_db[:, finger]),
    )


def _limited_by(device: Device, candidate: Candidate, amplitude: Array, wanted_level_db: float, spare_db: float) -> str:
    """What limits the drive, in words: the level, a full scale, the edge of a band, or else the bar itself."""
    parts = list[str]()
    if np.isfinite(wanted_level_db) and spare_db < _AT_LEVEL_DB:
        parts.append("level" if spare_db >= -LEVEL_TOLERANCE_DB else "level out of reach")
    for actuator, hz, fraction in zip(device.actuators, candidate.drive.frequency_hz, amplitude, strict=True):
        if fraction > _FULL * device.limits.amplitude:
            parts.append(f"full scale of {actuator.name}")
        if fraction > 0 and min(abs(hz - edge) for edge in actuator.band_hz) < FREQUENCY_STEP_HZ:
            parts.append(f"band of {actuator.name}")
    return "; ".join(parts) or "the bar itself"


def _expected_contrast_db(figures: DriveFigures, felt: list[int], quiet: list[int]) -> float | None:
    if not quiet:
        return None
    mean = figures.power[1:].mean(axis=0)
    return _db(float(mean[felt].min() / mean[quiet].max()))


def _range(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _db(ratio: float) -> float:
    return float(10 * np.log10(ratio)) if ratio > 0 else -np.inf
