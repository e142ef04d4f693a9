"""Law of powers under fingers: in every case those of a dense model with its fingers assembled."""

import numpy as np
import pytest

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.predict.at_positions import compute_powers
from tests.precompute.dense_model import DenseModel, drive_of
from tests.precompute.devices import any_device
from tests.precompute.sampled import fingers_of, sample_cases, threshold

either = pytest.mark.parametrize("coherent", [True, False], ids=["coherent", "a tone each"])
LOOKED_AT = (0, 3, 20, 32)


@any_device
@either
def test_powers_of_every_case_are_the_dense_models(device: Device, coherent: bool) -> None:
    """Powers of different tones, each over its threshold, add."""
    cases, (hz, amplitude) = sample_cases(device, (0, 2, 3)), drive_of(device, coherent)
    found, tones = compute_powers(assemble(device), cases, hz, amplitude), np.unique(hz)
    for case in LOOKED_AT:
        unit = DenseModel(device, fingers_of(cases, case)).unit_acceleration(tones, cases.position_m[case])
        each = abs(np.einsum("tpa,ta->tp", unit, np.where(hz == tones[:, None], amplitude, 0)))
        levels = each / np.array([threshold(tone) for tone in tones])[:, None]
        assert found[case] == pytest.approx((levels**2).sum(axis=0), rel=1e-5)
