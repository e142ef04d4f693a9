"""How many bars that differ from their device file a calibration accepts, and how many right ones it doubts. SIMULATED.

`python -m tests.studies.physics.wrong_bars [DEVICE] [--right N] [--wrong N] [--first SEED]`: every bar has its own
stiffnesses, dampings, full scale and modulus, is read at 22 places with five drives and noise, and is calibrated with
the usual parameters. The wrong ones, N of each kind, differ by one thing more, which is not fitted or lies beyond what
a fit can follow. Then lots of 18 right bars and two wrong ones get the verdicts of a fleet; that of a wrong bar is at
least RETEST where only its misfit doubts it, since a remedy, which may reject it, is not looked for.
"""

from collections import Counter, defaultdict
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device
from precompute.calibration.adequacy import adequacy_report, doubts_of
from precompute.calibration.calibrate import calibrate
from precompute.calibration.calibration_report import calibration_report
from precompute.fleet.units import Outcome
from precompute.fleet.verdict import judge, lot_values
from precompute.measurements.model import Flaws, even_places, simulate_measurements
from precompute.measurements.parameters import default_names
from precompute.measurements.types import lay_out
from tactable.shipped import find_device
from tests.precompute.measured import PAIRS_HZ, SENSOR_MASS_KG
from tests.studies.options import read_options

KINDS = ("nothing", "thickness", "length", "place", "material", "sensor", "bolt")
NOISE = 0.02
_RIGHT_IN_LOT = 18
_OWN = 0.03
"""Relative standard deviation of an actuator's full scale beside that of its lot."""
_MATERIALS = (("200 GPa", "7850 kg/m^3"), ("3.2 GPa", "1190 kg/m^3"), ("2.3 GPa", "1200 kg/m^3"))
"""Steel, acrylic and polycarbonate, where the file says aluminium."""


def truth_of(device: Device, kind: str, seed: int) -> tuple[Device, float, dict[str, str | float]]:
    """The bar that is there, the mass of the sensor on it in kg, and what else is wrong."""
    random = np.random.default_rng(seed)
    bar = device.bar
    values: dict[str, str | float] = {
        "bar.youngs_modulus": f"{bar.youngs_modulus_pa * random.uniform(0.95, 1.05)} Pa",
        "bar.stiffness_damping": f"{bar.stiffness_damping_s * np.exp(random.uniform(-1, 1))} s",
    }
    for number, each in enumerate(device.actuators, 1):
        values[f"actuator[{number}].stiffness"] = f"{each.stiffness_n_per_m * random.uniform(0.85, 1.2)} N/m"
    full_scale, own = random.uniform(0.8, 1.25), np.random.default_rng((seed, 1)).normal(1, _OWN, len(device.actuators))
    for number, each in enumerate(device.actuators, 1):
        values[f"actuator[{number}].full_scale"] = f"{each.full_scale_m * full_scale * own[number - 1]} m"
    sign, sensor_mass_kg, wrong = random.choice([-1, 1]), SENSOR_MASS_KG, dict[str, str | float]()
    if kind == "thickness":
        wrong = {"bar.thickness": f"{bar.thickness_m * (1 + sign * random.uniform(0.07, 0.3))} m"}
    elif kind == "length":
        wrong = {"bar.length": f"{bar.length_m * (1 + sign * random.uniform(0.02, 0.06))} m"}
    elif kind == "place":
        number = int(random.integers(len(device.actuators)))
        at_m = float(device.actuators[number].position_m.real)
        inwards = 1 if at_m < bar.length_m / 2 else -1
        wrong = {f"actuator[{number + 1}].position": f"{at_m + inwards * random.uniform(0.006, 0.025)} m"}
    elif kind == "material":
        modulus, density = _MATERIALS[int(random.integers(len(_MATERIALS)))]
        wrong = {"bar.youngs_modulus": modulus, "bar.density": density}
    elif kind == "sensor":
        sensor_mass_kg *= random.choice([0.25, 3.0, 5.0])
    elif kind == "bolt":
        number = int(random.integers(len(device.actuators)))
        loose = device.actuators[number].stiffness_n_per_m * random.uniform(0.05, 0.25)
        wrong = {f"actuator[{number + 1}].stiffness": f"{loose} N/m"}
    return device.with_values(values | wrong), sensor_mass_kg, wrong


def report_about(device: Device, kind: str, seed: int) -> dict[str, Any]:
    """The report of one bar's calibration. A remedy is looked for only where nothing else doubts it: it takes long."""
    bar, sensor_mass_kg, _ = truth_of(device, kind, seed)
    pairs = np.array(PAIRS_HZ[:5], dtype=np.float64)
    measured = simulate_measurements(bar, lay_out(pairs, even_places(bar), sensor_mass_kg), Flaws(NOISE), seed)
    measured.sensor_mass_kg[:] = SENSOR_MASS_KG  # what the file says
    found = calibrate(device, measured, default_names(device))
    report = calibration_report(found)
    return report if doubts_of(report) else report | {"adequacy": adequacy_report(device, found, {})}


def judge_lots(right: list[dict[str, Any]], wrong: list[tuple[str, dict[str, Any]]]) -> dict[str, Counter[str]]:
    """How many bars of each kind have each verdict, where two wrong ones at a time are in a lot with right ones."""
    counts = defaultdict[str, Counter[str]](Counter)
    for first in range(0, len(wrong), 2):
        good = [right[(first // 2 * _RIGHT_IN_LOT + number) % len(right)] for number in range(_RIGHT_IN_LOT)]
        lot = [*(("nothing", each) for each in good), *wrong[first : first + 2]]
        outcomes = [Outcome(kind, "", report=report) for kind, report in lot]
        values = lot_values(outcomes)
        for outcome in outcomes:
            counts[outcome.name][judge(outcome, {}, values).judgement.value] += 1
    return counts


def main() -> None:
    """Print how many bars of each kind are doubted, what is wrong with those that are not, and verdicts in lots."""
    options = read_options(__doc__, device=("reference-a",), right=200, wrong=34, first=1000)
    device, found = find_device(options.device), defaultdict[str, list[dict[str, Any]]](list)
    with threadpool_limits(1, "blas"):
        for kind in KINDS:
            for seed in range(options.first, options.first + (options.right if kind == "nothing" else options.wrong)):
                found[kind].append(report_about(device, kind, seed))
                doubts = doubts_of(found[kind][-1])
                if bool(doubts) == (kind == "nothing"):
                    print(f"{kind} {seed}:", *truth_of(device, kind, seed)[1:], doubts or "accepted", flush=True)
            print(f"{kind:10} {sum(map(bool, map(doubts_of, found[kind])))} of {len(found[kind])} doubted", flush=True)
    wrong = [(kind, found[kind][number]) for number in range(options.wrong) for kind in KINDS[1:]]
    for kind, counts in judge_lots(found["nothing"], wrong).items():
        print(f"{kind:10} in lots: {dict(counts)}")


if __name__ == "__main__":
    main()
