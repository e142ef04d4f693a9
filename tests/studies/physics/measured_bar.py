"""What a bar that was measured by stepped sine is worth: responses, fitted parameters, drives. SIMULATED.

    python -m tests.studies.physics.measured_bar [SEEDS] [--places N]

For each seed a bar differs from its description (stiffness, full scale and damping of its actuators, Young's modulus),
and a converter has noise, hum, latency, jitter, a clock that drifts, an offset, clipping and lost samples. `measure`
reads the bar through the real code, `calibrate` fits it, and steady drives for random placements are solved for the
fitted and for the described bar; all are evaluated on the true bar, beside those that were solved for it. The last line
sums the seeds up.
"""

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Array
from engine.device import Device
from engine.steady.steady_solver import SteadySolver
from engine.touch import Placement
from precompute.calibration.calibrate import Estimate, calibrate
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import with_changes
from precompute.measurements.types import Kind, Measurements
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.sampling.placements import Anywhere, random_placements
from precompute.sampling.steady_modes import steady_basis, steady_modes
from tactable.measure.apparatus import SIMULATED, ApparatusOptions, open_apparatus
from tactable.measure.simulated_bench import ConverterFlaws
from tactable.measure.stepped_sine import Reading, SteppedSineOptions
from tactable.measure.walk import (
    Method,
    RawFolder,
    Stop,
    default_frequencies,
    even_walk,
    measure_walk,
    measurements_of,
)
from tactable.shipped import find_device
from tests.precompute.measured import SENSOR_MASS_KG
from tests.studies.options import read_options

NAMES = (
    "actuator[1].stiffness",
    "actuator[2].stiffness",
    "actuator.damping",
    "actuator.full_scale",
    "bar.stiffness_damping",
    "bar.youngs_modulus",
)
STEPPED = Method(SteppedSineOptions())
LEVEL_DB = 20.0


@dataclass(frozen=True)
class SeedFigures:
    """What one bar gave: errors of its responses and parameters, and contrasts (placement,) lost on it, in dB.

    beyond: distance of the true value from the middle of the 95 % interval, in half widths, by parameter.
    """

    kept: int
    readings: int
    error_db: Array
    error_deg: Array
    beyond: dict[str, float]
    off: Array
    best_db: Array
    lost_db: Array
    lost_as_described_db: Array


def true_bar(device: Device, seed: int) -> tuple[Device, dict[str, float]]:
    """A bar that differs from its description, and the true values of what differs."""
    random = np.random.default_rng(seed)
    left, right, bar = device.actuators[0], device.actuators[1], device.bar
    values = {
        "actuator[1].stiffness": left.stiffness_n_per_m * random.uniform(0.92, 1.08),
        "actuator[2].stiffness": right.stiffness_n_per_m * random.uniform(0.92, 1.08),
        "actuator.damping": left.damping_n_s_per_m * random.uniform(0.7, 1.4),
        "actuator.full_scale": left.full_scale_m * random.uniform(0.9, 1.1),
        "bar.stiffness_damping": bar.stiffness_damping_s * random.uniform(0.7, 1.4),
        "bar.youngs_modulus": bar.youngs_modulus_pa * random.uniform(0.97, 1.03),
    }
    return with_changes(device, values), values


def flaws_of(seed: int) -> ConverterFlaws:
    """A converter as it may be, without an error of gain, which no response can tell from the full scale."""
    random = np.random.default_rng(1000 + seed)
    return ConverterFlaws(
        latency_s=float(random.uniform(0.003, 0.03)),
        jitter_s=0.001,
        drift=float(random.normal(0, 50e-6)),
        offset_m_per_s2=float(random.normal(0, 0.1)),
        noise_m_per_s2=float(random.uniform(0.005, 0.03)),
        hum_m_per_s2=float(random.uniform(0.0, 0.05)),
        clips_at_m_per_s2=float(random.uniform(20.0, 50.0)),
        drops_per_s=float(random.uniform(0.0, 0.1)),
    )


def measure_bar(
    device: Device, changes: dict[str, float], flaws: ConverterFlaws, seed: int, walk: tuple[Stop, ...]
) -> tuple[list[Reading], Measurements]:
    """Measure a simulated bar as the command does: all readings, and what is kept of them."""
    chosen = ApparatusOptions(
        *(SIMULATED, SIMULATED, STEPPED.stepped.most),
        sensor_mass_kg=SENSOR_MASS_KG,
        flaws=flaws,
        changes=changes,
        seed=seed,
        is_fine=True,
    )
    with tempfile.TemporaryDirectory() as folder, open_apparatus(device, chosen, lambda _: None) as apparatus:
        raw = RawFolder(Path(folder), device, walk, {})
        records = measure_walk(device, walk, apparatus, STEPPED, raw)
    readings = [reading for record in records for reading in record.readings]
    return readings, measurements_of(records, device, SENSOR_MASS_KG, Kind.RESPONSE, is_simulated=True)


def response_errors(true: Device, measured: Measurements) -> tuple[Array, Array]:
    """Errors (row,) in dB and degrees against the finite elements with the sensor on the bar."""
    response = np.exp(MeasurementModel(true, measured, ()).predict(np.zeros(0)).log_acceleration)
    ratio = measured.acceleration / response
    return abs(20 * np.log10(abs(ratio))), abs(np.degrees(np.angle(ratio)))


def contrasts_db(true: Device, believed: Device, placements: list[Placement]) -> Array:
    """Contrast (placement,) on the true bar of the drives that are solved for the believed one."""
    modes = steady_modes(steady_basis(assemble(believed)), believed.sweep.frequency_hz)
    solver, plant = SteadySolver(believed, modes), assemble(true)
    found = []
    for placement in placements:
        drive = solver.solve(placement.position_m, placement.is_felt, LEVEL_DB)
        hz = np.array([drive.frequency_hz])
        loaded = plant.with_fingers(placement.position_m, true.finger)
        unit = solve_response(loaded, hz).acceleration(np.array(placement.position_m))[0]
        level_db = 20 * np.log10(abs(drive.complex_amplitudes @ unit) / true.threshold.peak_m_per_s2(hz))
        is_felt = np.array(placement.is_felt)
        found.append(level_db[is_felt].min() - level_db[~is_felt].max())
    return np.array(found)


def study_seed(device: Device, seed: int, walk: tuple[Stop, ...], placements: list[Placement]) -> SeedFigures:
    """Print what one bar gives."""
    started_s = time.process_time()
    true, values = true_bar(device, seed)
    readings, measured = measure_bar(device, values, flaws_of(seed), seed, walk)
    bar_s, processor_s = sum(reading.seconds for reading in readings), time.process_time() - started_s
    error_db, error_deg = response_errors(true, measured)
    fitted = calibrate(device, measured, NAMES, starts=1)
    best, after, before = (contrasts_db(true, each, placements) for each in (true, fitted.device, device))
    figures = SeedFigures(
        kept=len(measured),
        readings=len(readings),
        error_db=error_db,
        error_deg=error_deg,
        beyond={e.parameter.name: beyond_interval(e, values[e.parameter.name]) for e in fitted.estimates},
        off=np.array([abs(e.value / values[e.parameter.name] - 1) for e in fitted.estimates]),
        best_db=best,
        lost_db=best - after,
        lost_as_described_db=best - before,
    )
    spoiled = [fault.name for reading in readings if reading.is_spoiled for fault in reading.faults]
    named = ", ".join(f"{spoiled.count(name)} {name}" for name in sorted(set(spoiled) - {"CLOCK_DRIFT"}))
    outside = ", ".join(f"{name} {value:.2f}" for name, value in figures.beyond.items() if value > 1) or "none"
    print(
        f"seed {seed}: {figures.kept} of {figures.readings} readings kept (the others: {named or 'none'}), "
        f"{bar_s:.0f} s of driving ({processor_s:.0f} s of processor); {figures_text([figures])}; outside, in half "
        f"widths of their intervals: {outside}",
        flush=True,
    )
    return figures


def beyond_interval(estimate: Estimate, true: float) -> float:
    """Distance of the true value from the estimate, in half widths of the 95 % interval on that side."""
    edge = estimate.high if true > estimate.value else estimate.low
    return abs(math.log(true / estimate.value)) / max(abs(math.log(edge / estimate.value)), 1e-12)


def off_by(error_db: Array, error_deg: Array) -> str:
    """Percentiles of errors of responses, in words."""
    db, degrees = ("/".join(f"{v:.3f}" for v in np.percentile(each, (50, 95, 100))) for each in (error_db, error_deg))
    return f"off by (50/95/100 %) {db} dB, {degrees} deg"


def figures_text(seeds: Sequence[SeedFigures]) -> str:
    """Errors, intervals and contrasts of one or several bars, in words."""
    names = ("error_db", "error_deg", "off", "lost_db", "best_db", "lost_as_described_db")
    error_db, error_deg, off, lost, best, before = (
        np.concatenate([getattr(each, name) for each in seeds]) for name in names
    )
    beyond = np.array([value for each in seeds for value in each.beyond.values()])
    return (
        f"response {off_by(error_db, error_deg)}; {np.count_nonzero(beyond <= 1)} of {len(beyond)} "
        f"parameters within their intervals, off by {100 * np.median(off):.3f} % (most {100 * max(off):.3f} %); "
        f"contrast (median of {len(lost)}) {np.median(best):.2f} dB for the true bar, lost {np.median(lost):.3f} dB "
        f"(95 %: {np.percentile(lost, 95):.3f}) by the measured one, {np.median(before):.2f} dB (95 %: "
        f"{np.percentile(before, 95):.2f}) by the description"
    )


def summary_text(seeds: Sequence[SeedFigures]) -> str:
    """The seeds together, and how often each parameter lies within its interval."""
    kept, readings = sum(each.kept for each in seeds), sum(each.readings for each in seeds)
    covered = ", ".join(
        f"{name} {sum(each.beyond[name] <= 1 for each in seeds)}"
        f" (median distance {np.median([each.beyond[name] for each in seeds]):.2f} half widths)"
        for name in seeds[0].beyond
    )
    figures = figures_text(seeds)
    return f"{len(seeds)} seeds: {kept} of {readings} readings kept; {figures}; within, of {len(seeds)}: {covered}"


def main() -> None:
    """Print a line for each seed, and their summary."""
    asked = read_options(__doc__, seeds=(5,), places=6)
    device = find_device("reference-a")
    with threadpool_limits(1, "blas"):
        free_hz = default_frequencies(device)
        chosen_hz = [free_hz[round(k)] for k in np.linspace(0, len(free_hz) - 1, min(8, len(free_hz)))]
        walk = even_walk(device, asked.places, chosen_hz)
        placements = random_placements(device, Anywhere(placements=20, seed=7))  # one of two fingers feels
        print(summary_text([study_seed(device, seed, walk, placements) for seed in range(asked.seeds)]), flush=True)


if __name__ == "__main__":
    main()
