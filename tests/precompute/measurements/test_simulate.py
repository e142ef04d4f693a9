"""Laws of simulated readings: the model's without flaws, as noisy and as often wrong as asked, seeded and marked."""

import numpy as np
import pytest

from precompute.measurements.simulate import Flaws
from precompute.measurements.types import Kind
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, PAIRS_HZ, read_bar

DEVICE = shipped("reference-a")
CLEAN = read_bar(DEVICE, {}, PAIRS_HZ)


def test_noise_is_as_large_as_asked_and_of_a_response_in_size_and_phase() -> None:
    drives_hz = [(hz, NAN) for hz in range(60, 70)]
    for kind, parts in ((Kind.PEAK, [0.05, 0.0]), (Kind.RESPONSE, [0.05, 0.05])):
        clean, noisy = (read_bar(DEVICE, {}, drives_hz, Flaws(noise=n), kind=kind) for n in (0, 0.05))
        ratio = np.log(noisy.acceleration / clean.acceleration)
        assert [np.std(ratio.real), np.std(ratio.imag)] == pytest.approx(parts, rel=0.2)


def test_as_many_are_wrong_by_3_as_asked() -> None:
    ratio = np.abs(read_bar(DEVICE, {}, PAIRS_HZ, Flaws(wrong=0.1)).acceleration / CLEAN.acceleration)
    wrong = ratio[np.abs(ratio - 1) > 1e-9]
    assert len(wrong) == round(0.1 * len(CLEAN))
    assert np.exp(np.abs(np.log(wrong))) == pytest.approx(3)
