"""How often the intervals of a calibration hold where complex responses differ in quality. SIMULATED.

    python -m tests.studies.physics.uneven_readings [BARS]

Each bar is one of `measured_bar`, read at 6 places and 8 frequencies of each actuator, with the errors that `measure`
has: some hundredths of a per cent where the bar moves, up to 2 % where it hardly stands out of the noise of the sensor.
Printed is the share of the 95 % intervals that hold the true value, by parameter, for errors summed reading by reading
as `calibrate` does, and for errors that are taken as even.
"""

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Mask
from engine.device import Device
from precompute.calibration.calibrate import pose_fit
from precompute.calibration.confidence import compute_confidence
from precompute.calibration.fit import fit
from precompute.measurements.model import MeasurementModel, even_places
from precompute.measurements.parameters import find_parameters
from precompute.measurements.types import Kind, Measurements, lay_out
from tactable.shipped import find_device
from tests.precompute.measured import SENSOR_MASS_KG
from tests.studies.options import read_options
from tests.studies.physics.measured_bar import NAMES, true_bar

HZ = (64.0, 104.0, 125.5, 165.0, 189.0, 209.0, 233.0, 294.5)
LEAST, MOST = 0.0004, 0.02
"""Relative errors of the best and of the worst readings."""
NOISE = 0.002
"""Of the sensor, as a fraction of the median response."""


def measure_uneven(true: Device, seed: int) -> Measurements:
    """Responses of a bar, each with an error of its own size."""
    drives = np.array([[hz, np.nan] for hz in HZ] + [[np.nan, hz] for hz in HZ])
    layout = lay_out(drives, even_places(true, 6), SENSOR_MASS_KG, Kind.RESPONSE)
    response = np.exp(MeasurementModel(true, layout, ()).predict(np.zeros(0)).log_acceleration)
    random, rows = np.random.default_rng(500 + seed), len(layout)
    noise = NOISE * np.median(abs(response)) * random.uniform(0.2, 1.5, rows) / abs(response)
    size = np.minimum(np.hypot(LEAST, noise), MOST)
    error = size * (random.standard_normal(rows) + 1j * random.standard_normal(rows)) / np.sqrt(2)
    return replace(layout, acceleration=response * (1 + error), is_simulated=True)


def measure_coverage(bars: int) -> tuple[Mask, Mask]:
    """Whether the intervals hold the true values (bar, parameter), and with errors that are taken as even."""
    device, held, held_even = find_device("reference-a"), list[Mask](), list[Mask]()
    for seed in range(bars):
        true, values = true_bar(device, seed)
        parameters = find_parameters(device, NAMES, {}, SENSOR_MASS_KG)
        found = fit(pose_fit(device, measure_uneven(true, seed), parameters), 1, 0)
        off = abs(found.coordinate - [parameter.coordinate(values[parameter.name]) for parameter in parameters])
        for is_even, out in ((False, held), (True, held_even)):
            found.problem.misfit.is_peak = is_even  # peaks are taken as even
            confidence = compute_confidence(found)
            out.append(off <= confidence.quantile * np.sqrt(np.diag(confidence.covariance)))
    return np.array(held), np.array(held_even)


def main() -> None:
    """Print the shares."""
    with threadpool_limits(1, "blas"):
        found = measure_coverage(read_options(__doc__, bars=(100,)).bars)
    for name, held in zip(("reading by reading", "taken as even"), found, strict=True):
        shares = ", ".join(f"{key} {share:.2f}" for key, share in zip(NAMES, held.mean(axis=0), strict=True))
        print(f"{name}: {held.mean():.3f} of {held.size} intervals hold the true value ({shares})")


if __name__ == "__main__":
    main()
