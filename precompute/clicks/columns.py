"""Table rows of solved clicks: samples as integers, and accelerations of the nominal plant."""

from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.table import ClickEntry
from engine.table.click import ClickZone, LevelSpread
from precompute.clicks.basis import EVALUATION_RATE_HZ, EVALUATIONS_PER_SAMPLE, RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.solver import FULL_SCALE, Click
from precompute.entries.prediction import States, touched_zones
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant

Array = NDArray[np.float64]

_STEPS = 12
"""Steps of the nominal plant for each sample; acceleration changes sharply at the corners of the waveform."""
_SILENT = 1e-15


class ClickTabulator:
    """Makes the table rows of one device's clicks; `wanted_db` is the level of the options, None for the strongest."""

    def __init__(self, device: Device, wanted_db: float | None) -> None:
        self._device = device
        self._wanted_level_db = np.inf if wanted_db is None else wanted_db
        self._levels_db = (*device.levels_db, np.inf)
        self._basis = compute_basis(assemble(device))
        self._filter = threshold_filter(EVALUATION_RATE_HZ)

    def tabulate(self, states: States, click: Click) -> ClickEntry:
        """The row of a state: the click for fingers in the middles of its zones."""
        evaluation, touched = click.evaluation, touched_zones(states)
        samples = np.rint(FULL_SCALE * click.waveform.T).astype(np.int16)
        acceleration, weighted = self._nominal(samples / FULL_SCALE, click.placement.position_m)
        felt = weighted[:, click.placement.felt]
        zones: dict[int, ClickZone] = {
            zone: ClickZone(float(acceleration[:, i].max()), _decibels(weighted[:, i].max()))
            for i, zone in enumerate(touched)
        }
        return ClickEntry(
            states=states,
            sample_rate_hz=round(click.rate_hz),
            samples=samples,
            amplitude=1.0,
            wanted_level_db=self._wanted_level_db,
            achieved=click.achieved,
            felt=LevelSpread(*astuple(evaluation.felt)),
            quiet=None if evaluation.quiet is None else LevelSpread(*astuple(evaluation.quiet)),
            zones=tuple(zones.get(zone) for zone in range(len(states))),
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

    def _nominal(self, waveform: Array, position_m: tuple[float, ...]) -> tuple[Array, Array]:
        """Magnitudes (time, finger) under samples (sample, actuator): acceleration, and weighted by the threshold."""
        rate_hz = _STEPS * SAMPLE_RATE_HZ
        plant = TransientPlant(self._basis, np.array(position_m), rate_hz)
        plant.touch([(at_m, self._device.finger) for at_m in position_m])
        at = np.arange((len(waveform) - 1) * _STEPS + 1) / _STEPS
        moved = np.column_stack([np.interp(at, np.arange(len(waveform)), column) for column in waveform.T])
        rest = np.zeros((round(RINGDOWN_S * rate_hz), moved.shape[1]))
        acceleration, _ = plant.run(np.concatenate([moved, rest]))
        looked_at = acceleration[:: _STEPS // EVALUATIONS_PER_SAMPLE].T
        weighted = np.stack([np.convolve(course, self._filter)[: len(course)] for course in looked_at], axis=1)
        return abs(acceleration), abs(weighted)

    def _exceeds_s(self, felt: Array, level_db: float, full_db: float) -> float | None:
        above = felt * 10 ** (min(0.0, level_db - full_db) / 20) > 1
        if not above.any(axis=0).all():
            return None
        return float(above.argmax(axis=0).max() / EVALUATION_RATE_HZ)


def _decibels(value: float) -> float:
    return float(20 * np.log10(max(value, _SILENT)))
