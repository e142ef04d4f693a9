"""Laws of a drive's figures: under every case those of a dense model with its fingers assembled."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.predict.performance import DriveFigures, compute_figures
from tests.precompute.dense_model import DenseModel, Figures, drive_of
from tests.precompute.devices import every_device, on_each
from tests.precompute.sampled import fingers_of, sample_fingers, threshold

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
DEVICES = every_device()
any_device = on_each(DEVICES)
either = pytest.mark.parametrize("coherent", [True, False], ids=["coherent", "a tone each"])
TOUCHED = (0, 2, 3)
LOOKED_AT = (0, 3, 20, 32)


@cache
def figures_of(device: Device, coherent: bool) -> DriveFigures:
    return compute_figures(assemble(device), sample_fingers(device), TOUCHED, *drive_of(device, coherent))


@cache
def dense(device: Device, case: int) -> DenseModel:
    return DenseModel(device, fingers_of(sample_fingers(device), case, TOUCHED))


@cache
def dense_figures(device: Device, coherent: bool, case: int) -> Figures:
    return dense(device, case).figures(*drive_of(device, coherent))


@any_device
@either
def test_shares_and_peaks_of_a_touch_are_the_dense_models(device: Device, coherent: bool) -> None:
    found = figures_of(device, coherent)
    for case in LOOKED_AT:
        expected = dense_figures(device, coherent, case)
        assert found.share[case] == pytest.approx(expected.share, rel=1e-5, abs=1e-9)
        assert found.peak[case] == pytest.approx(expected.peak, rel=1e-3)


@any_device
@either
def test_standard_figures_are_the_dense_models(device: Device, coherent: bool) -> None:
    found, expected = figures_of(device, coherent).standard, dense_figures(device, coherent, 0)
    assert found.share == pytest.approx(expected.share, rel=1e-5, abs=1e-9)
    assert found.peak == pytest.approx(expected.peak, rel=1e-4)
    assert found.dead == pytest.approx(expected.dead, rel=1e-2, abs=2e-3 * expected.peak.max())


@any_device
@either
def test_under_fingers_magnitudes_of_tones_add_and_powers_over_their_thresholds(device: Device, coherent: bool) -> None:
    found, sampled = figures_of(device, coherent), sample_fingers(device)
    hz, amplitude = drive_of(device, coherent)
    for case in LOOKED_AT:
        places_m = np.array([at for at, _ in fingers_of(sampled, case, TOUCHED)])
        tones = np.unique(hz)
        unit = dense(device, case).unit_acceleration(tones, places_m)
        each = abs(np.einsum("tpa,ta->tp", unit, np.where(hz == tones[:, None], amplitude, 0)))
        assert found.acceleration[case] == pytest.approx(each.sum(axis=0), rel=1e-5)
        levels = each / np.array([threshold(tone) for tone in tones])[:, None]
        assert found.power[case] == pytest.approx((levels**2).sum(axis=0), rel=1e-5)
