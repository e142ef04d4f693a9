"""A waveform and the plants it may meet to what is felt: levels, their range, and when."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.clicks.basis import LOOK_RATE_HZ
from precompute.clicks.responses import Responses

Array = NDArray[np.float64]

_SILENT = 1e-15


@dataclass(frozen=True)
class Levels:
    """Peaks of the weighted acceleration in dB above the detection threshold: nominal, and of sampled plants.

    low_db, middle_db, high_db: 5, 50 and 95 % of the sampled plants lie below.
    """

    nominal_db: float
    low_db: float
    middle_db: float
    high_db: float


@dataclass(frozen=True)
class Verdict:
    """What fingers feel of a waveform. felt: the weakest felt finger; quiet: the strongest quiet one, None if none is.

    Of the nominal plant: exceeds_s, when every felt finger has first passed its threshold (None: one never does);
    peak_s, when the last one has its peak; residual_db, the strongest felt finger from `residual_from_s` on.
    """

    felt: Levels
    quiet: Levels | None
    exceeds_s: float | None
    peak_s: float
    residual_from_s: float
    residual_db: float


def judge_waveform(
    waveform: Array, responses: Responses, felt: Sequence[int], quiet: Sequence[int], residual_from_s: float
) -> Verdict:
    """Verdict on base displacements (actuator, time); felt, quiet: which fingers of the responses, nominal first."""
    level_db = decibels(responses.peaks(waveform, [*felt, *quiet]))
    nominal = np.abs(responses.first(1).under(felt).play(waveform)[0])
    above = nominal > 1
    return Verdict(
        felt=_levels(level_db[:, : len(felt)].min(axis=1)),
        quiet=_levels(level_db[:, len(felt) :].max(axis=1)) if quiet else None,
        exceeds_s=float(above.argmax(axis=1).max() / LOOK_RATE_HZ) if above.any(axis=1).all() else None,
        peak_s=float(nominal.argmax(axis=1).max() / LOOK_RATE_HZ),
        residual_from_s=residual_from_s,
        residual_db=float(decibels(nominal[:, round(residual_from_s * LOOK_RATE_HZ) :].max())),
    )


def decibels(value: Array | float) -> Array:
    """20 lg of a value over threshold."""
    level_db: Array = 20 * np.log10(np.maximum(value, _SILENT))
    return level_db


def _levels(level_db: Array) -> Levels:
    low, middle, high = np.percentile(level_db[1:], [5, 50, 95]).tolist()
    return Levels(float(level_db[0]), low, middle, high)
