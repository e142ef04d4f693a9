"""The picked modes of simulated bars are those of the model."""

import numpy as np
import pytest

from precompute.measurements.measured_modes import parse_modes
from precompute.measurements.model import Flaws
from precompute.measurements.pick import pick_modes, write_modes
from precompute.measurements.types import Kind, MeasurementError, Measurements
from precompute.model.modal import compute_modes
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, PAIRS_HZ, read_bar

DEVICE = shipped("reference-d")


def responses(noise: float, hz: range = range(60, 301, 2), points: int = 3) -> Measurements:
    """Responses to each actuator without a sensor's mass."""
    drives = [(f, NAN) for f in hz] + [(NAN, f) for f in hz]
    return read_bar(DEVICE, {}, drives, Flaws(noise=noise), points=points, kind=Kind.RESPONSE, sensor_mass_kg=0.0)


@pytest.mark.parametrize(("noise", "of_frequency", "of_damping"), [(0.0, 1e-6, 1e-5), (0.02, 1e-3, 0.04)])
def test_the_modes_in_the_band_are_picked_at_any_scale(noise: float, of_frequency: float, of_damping: float) -> None:
    read = responses(noise)
    true = [m for m in compute_modes(DEVICE, np.array([0.1]), 300) if m.frequency_hz > 60]
    scaled = Measurements(**{**vars(read), "acceleration": 1e-3j * read.acceleration})
    picked = pick_modes(scaled, "r.nc")
    np.testing.assert_allclose(picked[:, 0], [m.frequency_hz for m in true], rtol=of_frequency)
    np.testing.assert_allclose(picked[:, 1], [m.damping_ratio for m in true], rtol=of_damping)
    again = parse_modes(write_modes(picked, scaled, "r.nc"), DEVICE, 0.0, "m.csv")
    np.testing.assert_allclose(again.frequency_hz, picked[:, 0], rtol=1e-7)
    assert again.is_simulated


def test_what_has_no_common_modes_is_refused_by_name() -> None:
    roving = Measurements(**{**vars(read := responses(0.0)), "sensor_mass_kg": np.full(len(read), 2e-3)})
    for wrong, part in (
        (roving, "sensor mass"),
        (read_bar(DEVICE, {}, PAIRS_HZ), "complex responses"),
        (responses(0.0, range(60, 80, 4)), "5 frequencies"),
    ):
        with pytest.raises(MeasurementError, match=part):
            pick_modes(wrong, "r.nc")
