"""Evaluation of a waveform on sampled plants: levels under the fingers, their spread, and when they come."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.clicks.basis import EVALUATION_RATE_HZ
from precompute.clicks.responses import Responses

Array = NDArray[np.float64]

_SILENT = 1e-15


@dataclass(frozen=True)
class Levels:
    """Peak levels in dB above the detection threshold: of the nominal plant, and 5th, 50th and 95th percentile.

    worst_db: of all plants, the weakest where felt, and the strongest where quiet.
    """

    nominal_db: float
    low_db: float
    middle_db: float
    high_db: float
    worst_db: float


@dataclass(frozen=True)
class Evaluation:
    """Levels and times of a waveform. felt: the weakest felt finger; quiet: the strongest quiet one, None without any.

    Of the nominal plant: exceeds_s, when every felt finger has exceeded its threshold (None: one never does); peak_s,
    when the last of them peaks; residual_db, the strongest felt finger from `residual_from_s` on.
    """

    felt: Levels
    quiet: Levels | None
    exceeds_s: float | None
    peak_s: float
    residual_from_s: float
    residual_db: float


def evaluate_waveform(
    waveform: Array, responses: Responses, felt: Sequence[int], quiet: Sequence[int], residual_from_s: float
) -> Evaluation:
    """Evaluate base displacements (actuator, time); felt, quiet: indices of fingers. The first scenario is nominal."""
    level_db = decibels(responses.peaks(waveform, [*felt, *quiet]))
    nominal = np.abs(responses.first(1).under(felt).play(waveform)[0])
    above = nominal > 1
    return Evaluation(
        felt=_levels(level_db[:, : len(felt)].min(axis=1), np.min),
        quiet=_levels(level_db[:, len(felt) :].max(axis=1), np.max) if quiet else None,
        exceeds_s=float(above.argmax(axis=1).max() / EVALUATION_RATE_HZ) if above.any(axis=1).all() else None,
        peak_s=float(nominal.argmax(axis=1).max() / EVALUATION_RATE_HZ),
        residual_from_s=residual_from_s,
        residual_db=float(decibels(nominal[:, round(residual_from_s * EVALUATION_RATE_HZ) :].max())),
    )


def decibels(value: Array | float) -> Array:
    """Level in dB of a value in units of the threshold."""
    level_db: Array = 20 * np.log10(np.maximum(value, _SILENT))
    return level_db


def _levels(level_db: Array, worst: Callable[[Array], np.float64]) -> Levels:
    low, middle, high = np.percentile(level_db[1:], [5, 50, 95]).tolist()
    return Levels(float(level_db[0]), low, middle, high, float(worst(level_db)))
