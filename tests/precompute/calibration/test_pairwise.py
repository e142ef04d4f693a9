"""The paper's way: exact without noise where each drive tells all, its average worse than one fit of all drives."""

import numpy as np
import pytest

from precompute.calibration.calibrate import calibrate
from precompute.calibration.pairwise import fit_pairwise
from tests.precompute.calibration.calibrations import DEVICE, noisy_calibration
from tests.precompute.measured import PAIRS_HZ, read_bar


def test_without_noise_every_drive_gives_the_same() -> None:
    truth = {"actuator[1].stiffness": 20e3, "actuator.full_scale": 0.45e-6}
    found = calibrate(DEVICE, read_bar(DEVICE, truth), list(truth), starts=1)
    pairwise = fit_pairwise(DEVICE, found)
    assert pairwise is not None
    assert pairwise.value == pytest.approx(np.tile(list(truth.values()), (3, 1)), rel=1e-6)
    assert pairwise.average == pytest.approx(list(truth.values()), rel=1e-6)
    assert pairwise.typical < 1e-6


@pytest.mark.long
def test_with_noise_the_average_explains_less_than_the_one_fit() -> None:
    pairwise = fit_pairwise(DEVICE, noisy_calibration())
    assert pairwise is not None
    assert pairwise.value.shape == (3, 6)
    assert pairwise.average == pytest.approx(pairwise.value.mean(axis=0))
    assert pairwise.typical > pairwise.joint_typical
    assert pairwise.joint_typical == pytest.approx(0.0135, rel=0.3)  # of 2 % noise the median size


@pytest.mark.parametrize(
    ("pairs_hz", "points", "names"),
    [
        (((150, 130),), 4, ["actuator.full_scale"]),
        (tuple((100 + i, 150) for i in range(25)), 4, ["actuator.full_scale"]),
        (PAIRS_HZ[:3], 2, ["actuator.full_scale", "bar.density"]),
    ],
    ids=["one drive", "very many", "no more readings than parameters"],
)
def test_some_drives_have_no_such_way(pairs_hz: tuple[tuple[float, float], ...], points: int, names: list[str]) -> None:
    found = calibrate(DEVICE, read_bar(DEVICE, {}, pairs_hz, points=points), names, starts=1)
    assert fit_pairwise(DEVICE, found) is None
