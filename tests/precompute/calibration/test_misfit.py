"""Laws of the misfit: phases within half a turn, derivatives by coordinates."""

from dataclasses import replace

import numpy as np
import pytest

from precompute.calibration.misfit import MisfitModel
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import find_parameters, paper_names, with_changes
from precompute.measurements.types import Kind
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, TRUTH, read_bar

DEVICE = shipped("reference-a")
PARAMETERS = find_parameters(with_changes(DEVICE, TRUTH), paper_names(DEVICE), {}, 0.0)
AT_TRUTH = np.array([parameter.coordinate(TRUTH[parameter.name]) for parameter in PARAMETERS])


def misfit_of(kind: Kind) -> MisfitModel:
    pairs_hz = ((150, 130), (200, NAN)) if kind is Kind.PEAK else ((150, NAN), (NAN, 200))
    read = read_bar(DEVICE, TRUTH, pairs_hz, points=5, kind=kind)
    return MisfitModel(MeasurementModel(DEVICE, read, PARAMETERS), read, PARAMETERS)


@pytest.mark.parametrize("kind", Kind)
def test_there_is_none_at_the_truth_and_slopes_are_by_the_coordinates(kind: Kind) -> None:
    model = misfit_of(kind)
    assert max(abs(model.at(AT_TRUTH).log_residual).max(), abs(model.at(AT_TRUTH).plain_residual).max()) < 1e-9
    for i in range(len(PARAMETERS)):
        step = np.eye(len(PARAMETERS))[i] * 1e-5
        above, below = model.at(AT_TRUTH + step), model.at(AT_TRUTH - step)
        here = model.at(AT_TRUTH)
        for name in ("log", "plain"):
            numeric = (getattr(above, f"{name}_residual") - getattr(below, f"{name}_residual")) / 2e-5
            found = getattr(here, f"{name}_slope")[:, i]
            assert np.abs(found - numeric).max() <= 1e-3 * np.abs(numeric).max() + 1e-6


def test_phases_differ_by_half_a_turn_at_most() -> None:
    read = read_bar(DEVICE, TRUTH, ((150, NAN),), points=5, kind=Kind.RESPONSE)
    turned = replace(read, acceleration=read.acceleration * np.exp(3.1j * np.arange(5)))
    model = MisfitModel(MeasurementModel(DEVICE, turned, PARAMETERS), turned, PARAMETERS)
    phase = model.at(AT_TRUTH).log_residual[5:]
    assert np.abs(phase).max() <= np.pi
    assert np.exp(1j * phase) == pytest.approx(np.exp(-3.1j * np.arange(5)), abs=1e-9)
