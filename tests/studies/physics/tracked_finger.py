"""What it brings to know the fingers from 50 ms of a drive, where fingers are threefold. SIMULATED.

    python -m tests.studies.physics.tracked_finger [DEVICE] [PLACEMENTS] [--noise 0.01] [--at 0.97] [--drift]

Each case is a placement of a felt and a quiet finger on a plant that differs from the device file within its spread,
has 1 % more or less of Young's modulus (standard deviation), and fingers of a log-normal factor of impedance, 95 % of
them within the device's factor, within 1 mm of where the digitizer tells. A sensor at a fraction of the length reads
the first 50 ms of the drive that is solved for the standard finger, from rest, with white noise (m/s^2 rms at 3200
samples a second: 0.01 is an ADXL355, 0.24 an ADXL345, by their data sheets). Drives and clicks are then made again for
what was found, and compared on the same plant:

- standard: for the standard finger and the spread of the file; wide: for all fingers that were drawn;
- measured: for the measured factors within their errors; moved too: on the measured plant as well; known: as if both
  were known exactly.

Printed are 5 and 50 % of felt over quiet in dB, of steady drives and of clicks, the share of clicks whose quiet finger
stays below 1 and 6 dB, and how well the factors are found, by how far the fingers lie apart.

With --drift instead: the clicks of the file on surfaces of another Young's modulus, over fresh plants.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Array, Complex
from base.points import clip_points
from engine.device import Device
from engine.steady.cases import FingerCases, axes_of, cases_at, sample_deviations
from engine.touch import Placement
from precompute.clicks import ClickSolver
from precompute.clicks.click_plants import SampledPlants
from precompute.clicks.click_responses import Responses
from precompute.clicks.click_solver import Plants
from precompute.clicks.evaluation import decibels
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from precompute.predict.at_positions import SteadyDesigner, compute_powers
from precompute.sampling.placements import Anywhere, random_placements
from precompute.sampling.plants import Fingers, sample_scenarios
from tactable.shipped import find_device
from tactable.track.estimator import LoadEstimator, scaled_finger
from tests.studies.options import read_options
from tests.studies.physics.anywhere import kept_share

RATE_HZ, FINE = 3_200.0, 8
WINDOW_S = 0.05
LEVEL_DB = 20.0
WAYS = ("standard", "wide", "measured", "moved too", "known")
KNOWN = 0.02  # error of a factor that counts as known; without any the solver would make sharp drives


@dataclass(frozen=True)
class Believed:
    """What a drive or click is made for: logarithms of the factors (finger,), their errors, and the device."""

    log_factor: Array
    error: Array
    device: Device


class FingerSolver(ClickSolver):
    """Solves clicks for fingers that are not the standard ones."""

    believed: Believed

    def _compute_plants(self, position_m: tuple[complex, ...]) -> Plants:
        pool, judged = (
            Responses(sampled.transfer(self._placed(sampled, position_m).first(count)), sampled.lines)
            for sampled, count in zip(self._sampled, self._counts(len(position_m)), strict=True)
        )
        return Plants(pool, judged)

    def _placed(self, sampled: SampledPlants, position_m: tuple[complex, ...]) -> Fingers:
        placed, finger = sampled.scenarios.place(position_m, 1e-3), self.device.finger
        # One deviate a finger: the one of the stiffness, scaled to a standard deviation of 1.
        ratio = np.log(placed.stiffness_n_per_m / finger.stiffness_n_per_m)
        factor = np.exp(self.believed.log_factor + self.believed.error * ratio / ratio[1:].std(axis=0))
        values = finger.stiffness_n_per_m, finger.damping_n_s_per_m, finger.mass_kg
        return Fingers(placed.position_m, *(factor * value for value in values))


@dataclass(frozen=True)
class Sensor:
    """A sensor at a point of the surface, its mass and its noise, m/s^2 rms."""

    at_m: complex
    mass_kg: float
    noise: float

    def measure(
        self,
        device: Device,
        true: Device,
        fingers: Sequence[tuple[complex, float]],
        told_m: list[complex],
        drive: Array,
        seed: int,
    ) -> Believed:
        """What the estimator finds in the first 50 ms of a drive (time, actuator), from rest."""
        weight = replace(device.finger, mass_kg=self.mass_kg, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0)
        plant = TransientPlant(compute_basis(assemble(true)), np.array([self.at_m]), FINE * RATE_HZ)
        plant.touch([(self.at_m, weight), *((at_m, scaled_finger(device.finger, each)) for at_m, each in fingers)])
        estimator = LoadEstimator(device, self.at_m, self.mass_kg, RATE_HZ)
        padded = np.pad(drive, ((FINE * estimator.margin, 0), (0, 0)))
        samples = np.column_stack([plant.accelerate(padded), padded])[::FINE]
        samples[:, 0] += self.noise * np.random.default_rng(seed).standard_normal(len(samples))
        found = estimator.take_window(samples, dict(enumerate(told_m)), 0.0)
        log_factor, error = np.array([found.loads[finger] for finger in range(len(fingers))]).T
        return Believed(log_factor, error, device if found.refusal else found.device)


def cases_of(device: Device, believed: Believed, positions_m: Array) -> FingerCases:
    """Cases of the steady solver for the fingers that are believed."""
    deviations, one = (
        sample_deviations(len(positions_m), 8, axes_of(device.surface.corner_m)),
        replace(device.finger, spread=math.e),
    )
    cases = cases_at(positions_m, deviations, replace(device, finger=one))
    standard = cases.impedance[0]
    exponent = np.log(cases.impedance / standard)[..., :1] * math.sqrt(3)  # even within -1 and 1, to a deviation of 1
    factor = np.exp(believed.log_factor[:, None] + believed.error[:, None] * exponent)
    return FingerCases(cases.position_m, standard * factor)


def onset(amplitude: Complex, frequency_hz: float) -> Array:
    """The first 50 ms (time, actuator) of a drive that fades in within 5 ms."""
    time_s = np.arange(round(WINDOW_S * RATE_HZ * FINE)) / (RATE_HZ * FINE)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.minimum(time_s / 5e-3, 1.0))
    return np.asarray((rise[:, None] * amplitude * np.exp(2j * np.pi * frequency_hz * time_s)[:, None]).imag)


def main() -> None:
    """Print the table."""
    options = read_options(
        __doc__, device=("reference-a",), placements=(60,), noise=0.01, at=0.97, mass=2e-3, drift=False
    )
    device = find_device(options.device)
    corner_m, placements = device.surface.corner_m, random_placements(device, Anywhere(options.placements, 2))
    at_m = options.at * corner_m.real
    at_m = complex(at_m, 0.3 * corner_m.imag) if isinstance(corner_m, complex) else at_m
    with threadpool_limits(1, "blas"):
        if options.drift:
            _run_drift(device, placements)
        else:
            _run(device, placements, Sensor(at_m, options.mass, options.noise))


def _run_drift(device: Device, placements: list[Placement]) -> None:
    """Print what a drift costs clicks that are made for none."""
    solver = ClickSolver(device)
    clicks = [solver.solve(placement).waveform.T for placement in placements]
    print("drift  felt (5 %), quiet (95 %), contrast (5, 50 %) dB; felt >= 14 and quiet <= 1, <= 6 dB")
    for drift in (0.0, 0.003, 0.005, 0.01, 0.02, 0.03):
        surface = replace(device.surface, youngs_modulus_pa=device.surface.youngs_modulus_pa * (1 + drift))
        warm, felt, quiet, contrast = ClickSolver(replace(device, surface=surface), basis=solver.basis), [], [], []
        for placement, waveform in zip(placements, clicks, strict=True):
            level_db = decibels(warm.plants_of(placement.position_m).judged.peaks(waveform, (0, 1))[1:])
            on, off = level_db[:, placement.felt[0]], level_db[:, placement.quiet[0]]
            felt.append(np.percentile(on, 5))
            quiet.append(np.percentile(off, 95))
            contrast += (on - off).tolist()
        kept = [100 * kept_share(felt, quiet, most) for most in (1, 6)]
        low, middle = np.percentile(contrast, (5, 50))
        half = np.median(felt), np.median(quiet)
        levels = " ".join(f"{level_db:6.1f}" for level_db in (*half, low, middle))
        print(f"{100 * drift:4.1f} % {levels} {kept[0]:5.0f} {kept[1]:5.0f} %")


def _run(device: Device, placements: list[Placement], sensor: Sensor) -> None:
    """Print what each way of knowing the fingers brings."""
    corner_m, spread = device.surface.corner_m, math.log(device.finger.spread) / 1.96
    random, designer = np.random.default_rng(7), SteadyDesigner(device)
    scenarios, solver = sample_scenarios(device, 2 * len(placements), 3), FingerSolver(device)
    plain = ClickSolver(device, basis=solver.basis)  # as a table has it: the standard finger, the spread of the file
    steady: list[list[float]] = []
    felt: list[list[float]] = []
    quiet: list[list[float]] = []
    off: list[tuple[float, float, float]] = []
    for number, placement in enumerate(placements):
        bent = scenarios.device_of(2 * number + 1)
        modulus_pa = bent.surface.youngs_modulus_pa * math.exp(0.01 * random.standard_normal())
        true = replace(bent, surface=replace(bent.surface, youngs_modulus_pa=modulus_pa))
        log_factor = spread * random.standard_normal(2)
        at_m, is_felt = np.array(placement.position_m), list(placement.is_felt)
        first = designer.solver.solve(placement.position_m, is_felt, LEVEL_DB)
        drive = onset(first.complex_amplitudes, first.frequency_hz)
        off_m = random.uniform(-1e-3, 1e-3, 4)
        lie_m = clip_points(at_m + (off_m[:2] + 1j * off_m[2:] if np.iscomplexobj(at_m) else off_m[:2]), corner_m)
        fingers = list(zip(lie_m.tolist(), np.exp(log_factor).tolist(), strict=True))
        found = sensor.measure(device, true, fingers, at_m.tolist(), drive, number)
        off += [
            (abs(at_m[0] - at_m[1]), f - t, e)
            for f, t, e in zip(found.log_factor, log_factor, found.error, strict=True)
        ]
        zero, wide = np.zeros(2), np.full(2, spread)
        beliefs = (
            Believed(zero, wide, device),
            replace(found, device=device),
            found,
            Believed(log_factor, np.full(2, KNOWN), true),
        )
        standard = np.array([[device.finger.stiffness_n_per_m, device.finger.damping_n_s_per_m, device.finger.mass_kg]])
        there = FingerCases(lie_m[None], standard * np.exp(log_factor)[None, :, None])
        drives = [first]
        clicks = [plain.solve(placement)]
        for believed in beliefs:
            own = designer if believed.device is device else SteadyDesigner(believed.device)
            drives.append(own.solver.solve_cases(cases_of(device, believed, at_m), placement.is_felt, LEVEL_DB))
            each = solver if believed.device is device else FingerSolver(believed.device, basis=solver.basis)
            each.believed = believed
            each.plants_of.cache_clear()
            clicks.append(each.solve(placement))
        plant = assemble(true)
        power = [
            compute_powers(plant, there, np.full(len(d.amplitudes), d.frequency_hz), d.complex_amplitudes)[0]
            for d in drives
        ]
        steady.append([float(10 * np.log10(p[is_felt].min() / p[~np.array(is_felt)].max())) for p in power])
        exact = SampledPlants(sample_scenarios(true, 2, 1), solver._sampled[0].lines)
        truth = Fingers(lie_m[None], *(standard[0, k] * np.exp(log_factor)[None] for k in range(3)))
        peaks = [Responses(exact.transfer(truth), exact.lines).peaks(click.waveform.T, (0, 1))[0] for click in clicks]
        felt.append([float(decibels(p[is_felt].min())) for p in peaks])
        quiet.append([float(decibels(p[~np.array(is_felt)].max())) for p in peaks])
    _print(np.array(steady), np.array(felt), np.array(quiet), np.array(off))


def _print(steady: Array, felt: Array, quiet: Array, off: Array) -> None:
    print(f"{'made for':10} {'steady 5, 50 %':>16} {'clicks 5, 50 %':>16} {'felt 50 %':>9} {'quiet <= 1, <= 6 dB':>20}")
    for way, name in enumerate(WAYS):
        s, c = np.percentile(steady[:, way], (5, 50)), np.percentile((felt - quiet)[:, way], (5, 50))
        shares = [100 * (quiet[:, way] <= most).mean() for most in (1, 6)]
        middle = np.median(felt[:, way])
        print(
            f"{name:10} {s[0]:8.1f} {s[1]:7.1f} {c[0]:8.1f} {c[1]:7.1f} {middle:9.1f} "
            f"{shares[0]:12.0f} {shares[1]:6.0f} %"
        )
    for low, high in ((0.0, 0.05), (0.05, 0.1), (0.1, 1.0)):
        part = off[(off[:, 0] >= low) & (off[:, 0] < high)]
        if len(part):
            errors, held = np.percentile(abs(part[:, 1]), (50, 90)), (abs(part[:, 1]) <= 2 * part[:, 2]).mean()
            print(
                f"{1e3 * low:3.0f} to {1e3 * high:4.0f} mm apart: factors off by {100 * errors[0]:.0f} % (50 %), "
                f"{100 * errors[1]:.0f} % (90 %); within 2 errors {100 * held:.0f} %"
            )


if __name__ == "__main__":
    main()
