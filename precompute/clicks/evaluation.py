"""Evaluation of a waveform: levels under fingers, their spread over sampled plants, and the nominal plant in time."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from base.arrays import Array, Complex, Single
from base.compiled import njit
from engine.device import Device
from engine.table import ClickEntry
from engine.table.clicks import ClickFigures, ClickFinger, LevelSpread
from engine.touch import Placement
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, EVALUATIONS_PER_SAMPLE, RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.click_responses import Responses
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transfers import threshold_filter
from precompute.model.transient import TransientPlant

PERCENTS = (5, 50, 95)
_SILENT = 1e-15
MANY = 800
_ENOUGH = 2  # plants a parameter below which a fit would follow them too closely: plain percentiles then
_HIGH = 0.6
"""Instants at which none of the few has this fraction of the lowest percentile are no peaks of the others either.

Promises of 600 random placements on three bars are the same without it to 1e-5 dB.
"""


class ManyPlants:
    """Percentiles of peaks over many plants, from the courses of few.

    A 95th percentile over a hundred plants errs by half a decibel under a single quiet finger, where little is left of
    what cancels. But a course is nearly linear in what varies from plant to plant (R^2 = 0.97 to 0.999 on three bars).
    So the courses of the few plants are fitted by least squares to their deviations, the fit says the peaks of hundreds
    of others, and their percentile is corrected by how far the fit misses that of the few (a control variate). Against
    3000 plants the 95th percentile of 80 errs by 0.05 dB in the mean and 0.1 to 0.4 dB from one placement to the next;
    the plain one by 0.1 and 0.2 to 0.6.

    few, many (plant, parameter): standardised deviations of the plants that are played, and of the others.
    """

    def __init__(self, few: Array, many: Array) -> None:
        one, other = (np.column_stack([np.ones(len(each)), each]) for each in (few, many))
        self._is_fitted = len(one) >= _ENOUGH * one.shape[1]
        self._solve = np.linalg.pinv(one).astype(np.float32)
        self._few, self._many = one.astype(np.float32), other.astype(np.float32)

    def percentiles(self, course: Single, peak: Array, percents: Sequence[float]) -> Array:
        """Percentiles (percent,) over many plants of the strongest finger's peak; course (few, finger, time).

        peak (few,): the strongest finger's, where it is known better than from the samples of the course.
        """
        if not self._is_fitted:
            return percentiles(peak, percents)
        flat = course.reshape(len(course), -1)
        lowest = percentiles(peak, percents[:1])[0]
        coefficients = self._solve @ flat[:, np.abs(flat).max(axis=0) > _HIGH * lowest]
        fitted, expected = (_greatest(each @ coefficients) for each in (self._few, self._many))
        plain, own, found = (percentiles(each, percents) for each in (peak, fitted, expected))
        # The fit's own percentile of the few tells by how much it misses; the same factor mends that of the many.
        return found * plain / own


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


def percentiles(value: Array, percents: Sequence[float]) -> Array:
    """As `numpy.percentile`, which takes ten times as long for a few hundred values."""
    rising = np.sort(value)
    place = (len(rising) - 1) * np.asarray(percents) / 100
    below = place.astype(np.int64)
    above = np.minimum(below + 1, len(rising) - 1)
    return rising[below] + (place - below) * (rising[above] - rising[below])


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _greatest(course: Single) -> Array:
    """Greatest magnitude of each row (row, time)."""
    out = np.empty(len(course))
    for i in range(len(course)):
        greatest = np.float32(0.0)
        for t in range(course.shape[1]):
            greatest = max(greatest, abs(course[i, t]))
        out[i] = greatest
    return out


_STEPS = 12  # steps for each sample; acceleration changes sharply at the corners of the waveform
_RINGING_STEPS = 4  # steps from _SHARP_S after the waveform on: a peak at 300 Hz is missed by less than 0.02 dB
_SHARP_S = 5e-3  # time after which what the last corner of the waveform excites above 1 kHz is damped


class NominalFingers:
    """The nominal plant of a device; modes: how many move. None: as many as the band needs, which takes kernels."""

    def __init__(self, device: Device, modes: int | None = None) -> None:
        self._device = device
        self._modes = compute_basis(assemble(device), modes)
        self._filter = threshold_filter(device.threshold, EVALUATION_RATE_HZ)
        self._plant_of = lru_cache(maxsize=4)(self._make_plant)
        """The plant with fingers at a tuple of positions; clicks with the same fingers come together."""

    def under(self, click: ClickEntry, position_m: tuple[complex, ...]) -> tuple[ClickFinger, ...]:
        """What a click gives to standard fingers at these positions, as it is played."""
        played = click.amplitude / SAMPLE_FULL_SCALE * click.samples.astype(np.float64)
        plant = self._plant_of(position_m)
        plant.rest()
        at = np.arange((len(played) - 1) * _STEPS + 1) / _STEPS
        moved = np.column_stack([np.interp(at, np.arange(len(played)), column) for column in played.T])
        moved = np.pad(moved, ((0, round(_SHARP_S * SAMPLE_RATE_HZ) * _STEPS), (0, 0)))
        plant.sample_rate_hz = _STEPS * SAMPLE_RATE_HZ
        driven = plant.accelerate(moved)
        plant.sample_rate_hz = _RINGING_STEPS * SAMPLE_RATE_HZ
        steps = round((RINGDOWN_S - _SHARP_S) * plant.sample_rate_hz)
        ringing = plant.accelerate(np.zeros((steps, moved.shape[1])))
        # The first instant of the ringing is one step after the last that was driven.
        evaluated = [
            driven[:: _STEPS // EVALUATIONS_PER_SAMPLE],
            ringing[_RINGING_STEPS // EVALUATIONS_PER_SAMPLE - 1 :: _RINGING_STEPS // EVALUATIONS_PER_SAMPLE],
        ]
        course = np.concatenate(evaluated)
        weighted: Array = np.stack([np.convolve(column, self._filter)[: len(course)] for column in course.T])
        acceleration: Array = abs(np.concatenate([driven, ringing]))
        return fingers_of(acceleration.T, abs(weighted))

    def _make_plant(self, position_m: tuple[complex, ...]) -> TransientPlant:
        plant = TransientPlant(self._modes, np.array(position_m), _STEPS * SAMPLE_RATE_HZ)
        plant.touch([(at_m, self._device.finger) for at_m in position_m])
        return plant
