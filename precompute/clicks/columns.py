"""Table rows of solved clicks: weights of the device's basis, and accelerations of the nominal plant."""

from dataclasses import astuple
from functools import lru_cache

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from engine.device import Device
from engine.table import ClickEntry
from engine.table.click import ClickFinger, LevelSpread
from engine.touch import Placement
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from precompute.clicks.basis import (
    EVALUATION_RATE_HZ,
    EVALUATIONS_PER_SAMPLE,
    RINGDOWN_S,
    SAMPLE_RATE_HZ,
    click_basis,
)
from precompute.clicks.options import ClickOptions
from precompute.clicks.solver import Click
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant

Array = NDArray[np.float64]

_STEPS = 12
"""Steps of the nominal plant for each sample; acceleration changes sharply at the corners of the waveform."""
_RINGING_STEPS = 4
"""Steps from _SHARP_S after the waveform on: a peak at 300 Hz is missed by less than 0.02 dB."""
_SHARP_S = 5e-3
"""Time after which what the last corner of the waveform excites above 1 kHz is damped."""
_SILENT = 1e-15


class ClickTabulator:
    """Makes the table rows of one device's clicks, solved with these options.

    modes: of the nominal plant; None: as many as the band needs, which takes compiled kernels to count.
    """

    def __init__(self, device: Device, options: ClickOptions, modes: int | None = None) -> None:
        self.basis = click_basis(device, options)
        self._device, self._lengths_s = device, options.lengths_s
        self._tolerance_m = device.spread.finger_position_m if options.tolerance_m is None else options.tolerance_m
        self._wanted_level_db = np.inf if options.wanted_db is None else options.wanted_db
        self._levels_db = (*device.levels_db, np.inf)
        self._modes = compute_basis(assemble(device), modes)
        self._filter = threshold_filter(device.threshold, EVALUATION_RATE_HZ)
        self._plant_of = lru_cache(maxsize=4)(self._make_plant)
        """The nominal plant with fingers at a tuple of positions; clicks with the same fingers come together."""

    def tabulate(self, click: Click) -> ClickEntry:
        """The row of a click for any placement."""
        evaluation = click.evaluation
        assert click.weights is not None  # only baselines have none, and no table holds them
        acceleration, weighted = self._nominal(click.waveform.T, click.placement.position_m)
        felt = weighted[:, click.placement.felt]
        return ClickEntry(
            placement=click.placement,
            tolerance_m=self._tolerance_m,
            basis=self.basis,
            basis_set=self._lengths_s.index(click.length_s),
            weights=click.weights.words,
            fraction_bits=click.weights.fraction_bits,
            amplitude=1.0,
            wanted_level_db=self._wanted_level_db,
            achieved=click.achieved,
            felt=LevelSpread(*astuple(evaluation.felt)),
            quiet=None if evaluation.quiet is None else LevelSpread(*astuple(evaluation.quiet)),
            fingers=_peaks(acceleration, weighted),
            exceeds_s={
                level_db: self._exceeds_s(felt, level_db, evaluation.felt.low_db) for level_db in self._levels_db
            },
            peak_s=evaluation.peak_s,
            residual_from_s=evaluation.residual_from_s,
            residual_db=evaluation.residual_db,
            objective=click.objective,
            bound_db=click.bound_db,
            gap_db=click.gap_db,
        )

    def fingers_of(self, entry: ClickEntry, placement: Placement) -> tuple[ClickFinger, ...]:
        """What a click gives to standard fingers of any placement, as it is played, in the nominal plant."""
        played = entry.amplitude / SAMPLE_FULL_SCALE * entry.samples.astype(np.float64)
        return _peaks(*self._nominal(played, placement.position_m))

    def _nominal(self, waveform: Array, position_m: tuple[float, ...]) -> tuple[Array, Array]:
        """Magnitudes (time, finger) under samples (sample, actuator): acceleration, and weighted by the threshold."""
        plant = self._plant_of(position_m)
        plant.rest()
        at = np.arange((len(waveform) - 1) * _STEPS + 1) / _STEPS
        moved = np.column_stack([np.interp(at, np.arange(len(waveform)), column) for column in waveform.T])
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
        weighted = scipy.signal.oaconvolve(course, self._filter[:, None], axes=0)[: len(course)]
        return abs(np.concatenate([driven, ringing])), abs(weighted)

    def _make_plant(self, position_m: tuple[float, ...]) -> TransientPlant:
        plant = TransientPlant(self._modes, np.array(position_m), _STEPS * SAMPLE_RATE_HZ)
        plant.touch([(at_m, self._device.finger) for at_m in position_m])
        return plant

    def _exceeds_s(self, felt: Array, level_db: float, full_db: float) -> float | None:
        above = felt * 10 ** (min(0.0, level_db - full_db) / 20) > 1
        if not above.any(axis=0).all():
            return None
        return float(above.argmax(axis=0).max() / EVALUATION_RATE_HZ)


def _peaks(acceleration: Array, weighted: Array) -> tuple[ClickFinger, ...]:
    """Greatest of magnitudes (time, finger), under each finger."""
    return tuple(
        ClickFinger(float(peak), _decibels(weighted_peak))
        for peak, weighted_peak in zip(acceleration.max(axis=0), weighted.max(axis=0), strict=True)
    )


def _decibels(value: float) -> float:
    return float(20 * np.log10(max(value, _SILENT)))
