"""Calibrations that several tests look at, made once."""

from functools import cache

from precompute.calibration.calibrate import Calibration, calibrate
from precompute.calibration.fit import MisfitModel, Problem, pose
from precompute.measurements.model import Flaws, MeasurementModel
from precompute.measurements.parameters import find_parameters, paper_names
from tests.precompute.devices import shipped
from tests.precompute.measured import TRUTH, read_bar

DEVICE = shipped("reference-a")


def problem_of(truth: dict[str, float], flaws: Flaws) -> Problem:
    """The fit of the paper's six to three drives of a bar with these values."""
    read, parameters = read_bar(DEVICE, truth, flaws=flaws), find_parameters(DEVICE, paper_names(DEVICE), {}, 0.0)
    return pose(MisfitModel(MeasurementModel(DEVICE, read, parameters), read, parameters))


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
