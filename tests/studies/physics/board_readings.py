"""What the board's own accelerometer is worth: errors of responses against the bar that it lies on. SIMULATED.

`python -m tests.studies.physics.board_readings [SEEDS]` reads reference-a at three places by an emulated ADXL345, whose
oscillator is up to 3 % off, another in each seed, and compares with the finite elements with the sensor on the bar.
"""

import time

import numpy as np
from threadpoolctl import threadpool_limits

from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind, lay_out
from tactable.measure.board_bench import BoardBench
from tactable.measure.board_sensor import open_board_sensor
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.simulated_bench import ConverterFlaws
from tactable.measure.stepped_sine import Reading, SteppedSine, SteppedSineOptions
from tactable.measure.walk import even_walk
from tactable.shipped import find_device
from tests.studies.options import read_options

PLACES, FREQUENCIES_HZ = 3, (75.0, 110.0, 135.0, 170.0, 209.0, 235.0, 265.0, 297.0)
MASS_KG, BIT_RATE_HZ, DRIFT = 2e-3, 1_000_000, 0.03
DEVICE = find_device("reference-a")


def read_seed(seed: int) -> list[tuple[Reading, complex, float]]:
    """Readings, each over its true response, with the drift of the part."""
    drift = DRIFT * np.random.default_rng(seed).uniform(-1, 1)
    bench, found = BoardBench(DEVICE, ConverterFlaws(drift=drift), seed, MASS_KG), []
    sensor = open_board_sensor(DEVICE, bench, bench, BIT_RATE_HZ)
    for stop in even_walk(DEVICE, PLACES, FREQUENCIES_HZ):
        bench.place(stop.position_m)
        with DrivenDevice(DEVICE, bench, bench, (1.0, 1.0), BIT_RATE_HZ, accelerometer=sensor) as driven:
            stepped = SteppedSine(DEVICE, driven, sensor, SteppedSineOptions())
            stepped.listen()
            for actuator, hz in stop.tones:
                reading, _ = stepped.read(actuator, hz)
                found.append((reading, reading.acceleration / _true(reading, stop.position_m), drift))
    return found


def _true(reading: Reading, position_m: complex) -> complex:
    drive = np.full((1, len(DEVICE.actuators)), np.nan)
    drive[0, reading.actuator] = reading.frequency_hz
    layout = lay_out(drive, np.array([position_m]), MASS_KG, Kind.RESPONSE)
    predicted = MeasurementModel(DEVICE, layout, ()).predict(np.zeros(0)).log_acceleration
    return complex(reading.amplitude * np.exp(predicted[0]))


def main() -> None:
    """Print a line for each seed."""
    print("SIMULATED; seed, drift, kept, time of driving, dB and degrees off by (50 / 95 / 100 %), processor time")
    for seed in range(read_options(__doc__, seeds=(2,)).seeds):
        start_s = time.process_time()
        with threadpool_limits(1, "blas"):
            found = read_seed(seed)
        kept = [(reading, ratio) for reading, ratio, _ in found if not reading.is_spoiled]
        ratios = np.array([ratio for _, ratio in kept])
        off_db, off_deg = abs(20 * np.log10(abs(ratios))), abs(np.degrees(np.angle(ratios)))
        pace = max(abs(reading.drift - drift) for reading, _, drift in found)
        db, degrees = (" / ".join(f"{x:.3f}" for x in np.percentile(each, (50, 95, 100))) for each in (off_db, off_deg))
        least = min(abs(reading.acceleration) for reading, _ in kept)
        print(
            f"{seed}: {100 * found[0][2]:+.2f} %, {len(kept)} of {len(found)}, "
            f"{sum(reading.seconds for reading, _, _ in found):.0f} s, {db} dB, {degrees} deg, clock known to "
            f"{1e6 * pace:.1f} ppm, least kept {least:.2f} m/s^2, {time.process_time() - start_s:.0f} s"
        )


if __name__ == "__main__":
    main()
