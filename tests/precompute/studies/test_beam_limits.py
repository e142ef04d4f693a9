"""Laws of where the theory of a bar ends."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device.parts import Plate
from precompute.studies.beam_limits import estimate_shear_error, estimate_torsion_hz, shortest_wave_m
from tests.precompute.devices import shipped, with_bar


@pytest.mark.parametrize("thickness_m", [0.004, 0.012])
def test_the_error_by_shear_is_that_of_timoshenkos_dispersion(thickness_m: float) -> None:
    device = with_bar(shipped("reference-a"), thickness_m=thickness_m)
    bar, omega = device.bar, 2 * np.pi * device.sweep.stop_hz
    E, rho, kG = bar.youngs_modulus_pa, bar.density_kg_per_m3, 5 / 6 * bar.youngs_modulus_pa / 2.66
    k = np.sqrt(omega / thickness_m * np.sqrt(12 * rho / E))
    inertia = thickness_m**2 / 12
    terms = [rho**2 * inertia / kG, -(rho + rho * inertia * k**2 * (1 + E / kG)), E * inertia * k**4]
    exact = np.sqrt(np.roots(terms).min())
    assert estimate_shear_error(device) == pytest.approx(omega / exact - 1, rel=0.05)


def test_the_error_by_shear_of_a_plate_is_that_of_a_published_thick_one() -> None:
    """NAFEMS, Selected Benchmarks for Natural Frequency Analysis, FV52: simply supported, 10 x 10 x 1 m of steel."""
    plate, thick = shipped("reference-p"), Plate(10.0, 10.0, 1.0, 200e9, 8000.0, 0.3, 0.0, 0.0)
    for published_hz, waves in ((45.897, 1 + 1), (109.44, 1 + 4), (167.89, 4 + 4)):
        kirchhoff_hz = waves * np.pi / 200 * np.sqrt(thick.bending_n_m / 8000)
        error = estimate_shear_error(replace(plate, surface=thick, sweep=replace(plate.sweep, stop_hz=kirchhoff_hz)))
        assert error == pytest.approx(kirchhoff_hz / published_hz - 1, rel=0.11)


def test_of_two_plates_of_one_wave_the_thicker_errs_more_and_none_is_said_to_twist_only() -> None:
    plate = shipped("reference-p")
    thicker = replace(plate, surface=replace(plate.surface, thickness_m=4 * plate.surface.thickness_m))
    assert shortest_wave_m(thicker) == pytest.approx(2 * shortest_wave_m(plate))
    assert estimate_shear_error(thicker) == pytest.approx(4 * estimate_shear_error(plate))
    assert estimate_torsion_hz(plate) is None
