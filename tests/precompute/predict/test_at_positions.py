"""Laws of figures at positions: those of a dense model and of the sampled cases, and rise times of an envelope."""

import numpy as np
import pytest

from engine.device import Device
from precompute.predict.at_positions import SAMPLES, PlacementFigures
from tests.engine.steady.solvers import DEVICES, designer_of
from tests.precompute.dense_model import DenseModel
from tests.precompute.sampled import threshold

POSITIONS_M, ROLES = (0.035, 0.12, 0.15), (True, False, False)


def figures_of(device: Device) -> PlacementFigures:
    return designer_of(device).solve(POSITIONS_M, ROLES, 10.0)


def touched_model(device: Device, positions_m: tuple[float, ...]) -> DenseModel:
    return DenseModel(device, [(at_m, device.finger) for at_m in positions_m])


@pytest.mark.parametrize("name", DEVICES)
def test_levels_are_those_of_a_dense_model_and_their_spread_that_of_the_sampled_cases(name: str) -> None:
    device = DEVICES[name]
    figures = figures_of(device)
    drive = figures.drive
    field = touched_model(device, POSITIONS_M).unit_acceleration(np.array([drive.frequency_hz]), np.array(POSITIONS_M))
    level_db = 20 * np.log10(abs(field[0] @ drive.complex_amplitudes) / threshold(drive.frequency_hz))
    assert figures.level_db == pytest.approx(level_db, abs=1e-3)
    assert figures.contrast_db == pytest.approx(level_db[0] - level_db[1:].max(), abs=1e-3)
    assert figures.level_db[0] == pytest.approx(drive.level_db[0], abs=0.05)
    sampled_db, spread = figures.sampled_level_db, figures.spread
    assert sampled_db.shape == (SAMPLES, len(POSITIONS_M))
    assert spread.felt.low_db < spread.felt.middle_db < spread.felt.high_db
    assert spread.quiet is not None and spread.contrast is not None
    contrast_db = sampled_db[:, 0] - sampled_db[:, 1:].max(axis=1)
    assert spread.contrast.low_db == pytest.approx(np.percentile(contrast_db, 5))
    assert figures.finger_percentiles(0) == spread.felt
    mean = (10 ** (sampled_db / 10)).mean(axis=0)
    assert figures.expected_contrast_db == pytest.approx(10 * np.log10(mean[0] / mean[1:].max()))
