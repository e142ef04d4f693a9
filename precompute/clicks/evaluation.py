"""Evaluation of a waveform on sampled plants: levels under the fingers, their spread, and when they come."""

from collections.abc import Sequence

import numpy as np

from base.arrays import Array, Complex
from engine.table.clicks import ClickFigures, ClickFinger, LevelSpread
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, EVALUATIONS_PER_SAMPLE
from precompute.clicks.click_responses import Responses
from precompute.clicks.percentiles import ManyPlants, percentiles

PERCENTS = (5, 50, 95)
_SILENT = 1e-15


def evaluate_waveform(
    waveform: Array,
    responses: Responses,
    placement: Placement,
    weighting: Complex,
    levels_db: Sequence[float],
    residual_from_s: float,
    many: ManyPlants,
) -> ClickFigures:
    """Evaluate base displacements (actuator, time) under the fingers of a placement; the first scenario is nominal.

    weighting (line,): factor from acceleration to weighted acceleration. levels_db: for `exceeds_s`, rising. many:
    plants like those of the responses but the first; the percentiles of the quiet fingers are over them.
    """
    felt, quiet = placement.felt, placement.quiet
    course, peak = responses.played(waveform)
    felt_db, quiet_db = _felt_levels(peak[:, felt].min(axis=1)), None
    if quiet:
        strongest = peak[:, quiet].max(axis=1)
        low_db, middle_db, high_db = decibels(many.percentiles(course[1:, quiet], strongest[1:], PERCENTS)).tolist()
        nominal_db, worst_db = (float(decibels(each)) for each in (strongest[0], strongest.max()))
        quiet_db = LevelSpread(nominal_db, low_db, middle_db, high_db, worst_db)
    acceleration, weighted = nominal_courses(responses.first(1), waveform, weighting)
    above = weighted[felt]
    return ClickFigures(
        felt=felt_db,
        quiet=quiet_db,
        fingers=fingers_of(acceleration, weighted),
        exceeds_s={each_db: _exceeds_s(above, min(0.0, each_db - felt_db.low_db)) for each_db in levels_db},
        peak_s=float(above.argmax(axis=1).max() / EVALUATION_RATE_HZ),
        residual_from_s=residual_from_s,
        residual_db=float(decibels(above[:, round(residual_from_s * EVALUATION_RATE_HZ) :].max())),
    )


def nominal_courses(responses: Responses, waveform: Array, weighting: Complex) -> tuple[Array, Array]:
    """Magnitudes (finger, time) at EVALUATION_RATE_HZ in one plant: acceleration, and weighted by the threshold.

    Acceleration lacks what lies above the lines, from the corners of the waveform: under felt fingers 0.5 % of its
    peak, under quiet ones up to a tenth.
    """
    lines, spectrum = responses.lines, responses.spectrum(waveform)[0]
    acceleration = (spectrum / weighting).astype(np.complex64)
    one, other = (np.abs(lines.course(each, EVALUATIONS_PER_SAMPLE)) for each in (acceleration, spectrum))
    return one.astype(np.float64), other.astype(np.float64)


def fingers_of(acceleration: Array, weighted: Array) -> tuple[ClickFinger, ...]:
    """Greatest of magnitudes (finger, time), under each finger."""
    levels_db = decibels(weighted.max(axis=1)).tolist()
    return tuple(ClickFinger(*each) for each in zip(acceleration.max(axis=1).tolist(), levels_db, strict=True))


def decibels(value: Array | float) -> Array:
    """Level in dB of a value in units of the threshold."""
    return 20 * np.log10(np.maximum(value, _SILENT))


def _exceeds_s(weighted: Array, change_db: float) -> float | None:
    above = weighted * 10 ** (change_db / 20) > 1
    return float(above.argmax(axis=1).max() / EVALUATION_RATE_HZ) if above.any(axis=1).all() else None


def _felt_levels(weakest: Array) -> LevelSpread:
    """Of the weakest felt finger's peaks (plant,), the nominal plant first."""
    level_db = decibels(weakest)
    low, middle, high = percentiles(level_db[1:], PERCENTS).tolist()
    return LevelSpread(float(level_db[0]), low, middle, high, float(level_db.min()))
