"""Calibrations that several tests look at, made once."""

from functools import cache

from precompute.calibration.calibrate import Calibration, calibrate
from precompute.measurements.parameters import paper_names
from precompute.measurements.simulate import Flaws
from tests.precompute.devices import shipped
from tests.precompute.measured import TRUTH, read_bar

DEVICE = shipped("reference-a")


@cache
def noisy_calibration() -> Calibration:
    """The paper's six from three drives, 2 % noise, 5 % of the readings wrong."""
    return calibrate(
        DEVICE, read_bar(DEVICE, TRUTH, flaws=Flaws(noise=0.02, wrong=0.05)), paper_names(DEVICE), starts=1
    )


@cache
def published_calibration() -> Calibration:
    """The same with the published sigma, which no reading tells from 0."""
    truth = {**TRUTH, "bar.mass_damping": DEVICE.bar.mass_damping_per_s}
    return calibrate(DEVICE, read_bar(DEVICE, truth, flaws=Flaws(noise=0.02)), paper_names(DEVICE), starts=1)
