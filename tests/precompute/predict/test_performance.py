"""Laws of a drive's figures: under every case those of a dense model with its fingers assembled."""

import numpy as np
import pytest

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.predict.performance import compute_figures
from tests.precompute.dense_model import DenseModel, drive_of
from tests.precompute.devices import any_device
from tests.precompute.sampled import sample_fingers, threshold

either = pytest.mark.parametrize("coherent", [True, False], ids=["coherent", "a tone each"])
TOUCHED = (0, 2, 3)
LOOKED_AT = (0, 3, 20, 32)


@any_device
@either
def test_figures_of_every_touch_are_the_dense_models_and_the_standard_ones_those_of_the_first(
    device: Device, coherent: bool
) -> None:
    """Under fingers magnitudes of tones add, and powers over their thresholds."""
    sampled, (hz, amplitude) = sample_fingers(device), drive_of(device, coherent)
    found, tones = compute_figures(assemble(device), sampled, TOUCHED, hz, amplitude), np.unique(hz)
    for case in LOOKED_AT:
        fingers = sampled.fingers(case, TOUCHED)
        model = DenseModel(device, fingers)
        expected = model.figures(hz, amplitude)
        assert found.share[case] == pytest.approx(expected.share, rel=1e-5, abs=1e-9)
        assert found.peak[case] == pytest.approx(expected.peak, rel=1e-3)
        unit = model.unit_acceleration(tones, np.array([at for at, _ in fingers]))
        each = abs(np.einsum("tpa,ta->tp", unit, np.where(hz == tones[:, None], amplitude, 0)))
        assert found.acceleration[case] == pytest.approx(each.sum(axis=0), rel=1e-5)
        levels = each / np.array([threshold(tone) for tone in tones])[:, None]
        assert found.power[case] == pytest.approx((levels**2).sum(axis=0), rel=1e-5)
    assert found.standard.share == pytest.approx(found.share[0], rel=1e-9)
    assert found.standard.peak == pytest.approx(found.peak[0], rel=1e-3)
