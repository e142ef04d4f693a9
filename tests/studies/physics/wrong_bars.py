"""How many bars that differ from their device file a calibration accepts, and how many right ones it doubts. SIMULATED.

`python -m tests.studies.physics.wrong_bars [DEVICE] [--draws N]`: every bar has its own stiffnesses, dampings, full
scale and modulus, is read at 22 places with five drives and noise, and is calibrated with the usual parameters. The
wrong ones differ by one thing more, which is not fitted or lies beyond what a fit can follow.
"""

import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device
from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.calibrate import calibrate
from precompute.calibration.calibration_report import calibration_report
from precompute.calibration.doubts import doubts_of
from precompute.calibration.misfit import Loss
from precompute.measurements.parameters import default_names
from precompute.measurements.simulate import Flaws, even_places, simulate_measurements
from precompute.measurements.types import lay_out
from tactable.shipped import find_device
from tests.precompute.measured import PAIRS_HZ, SENSOR_MASS_KG
from tests.studies.options import read_options

KINDS = ("nothing", "thickness", "length", "place", "material", "sensor", "bolt")
NOISE = 0.02
_MATERIALS = (("200 GPa", "7850 kg/m^3"), ("3.2 GPa", "1190 kg/m^3"), ("2.3 GPa", "1200 kg/m^3"))
"""Steel, acrylic and polycarbonate, where the file says aluminium."""


def truth_of(device: Device, kind: str, seed: int) -> tuple[Device, float]:
    """The bar that is there, and the mass of the sensor on it in kg."""
    random = np.random.default_rng(seed)
    bar = device.bar
    values: dict[str, str | float | list[str]] = {
        "bar.youngs_modulus": f"{bar.youngs_modulus_pa * random.uniform(0.95, 1.05)} Pa",
        "bar.stiffness_damping": f"{bar.stiffness_damping_s * np.exp(random.uniform(-1, 1))} s",
    }
    for number, each in enumerate(device.actuators, 1):
        values[f"actuator[{number}].stiffness"] = f"{each.stiffness_n_per_m * random.uniform(0.85, 1.2)} N/m"
    full_scale = random.uniform(0.8, 1.25)
    for number, each in enumerate(device.actuators, 1):
        values[f"actuator[{number}].full_scale"] = f"{each.full_scale_m * full_scale} m"
    sign, sensor_mass_kg = random.choice([-1, 1]), SENSOR_MASS_KG
    if kind == "thickness":
        values["bar.thickness"] = f"{bar.thickness_m * (1 + sign * random.uniform(0.07, 0.3))} m"
    elif kind == "length":
        values["bar.length"] = f"{bar.length_m * (1 + sign * random.uniform(0.02, 0.06))} m"
    elif kind == "place":
        number = int(random.integers(len(device.actuators)))
        at_m = float(device.actuators[number].position_m.real)
        inwards = 1 if at_m < bar.length_m / 2 else -1
        values[f"actuator[{number + 1}].position"] = f"{at_m + inwards * random.uniform(0.006, 0.025)} m"
    elif kind == "material":
        values["bar.youngs_modulus"], values["bar.density"] = _MATERIALS[int(random.integers(len(_MATERIALS)))]
    elif kind == "sensor":
        sensor_mass_kg *= random.choice([0.25, 3.0, 5.0])
    elif kind == "bolt":
        number = int(random.integers(len(device.actuators)))
        loose = device.actuators[number].stiffness_n_per_m * random.uniform(0.05, 0.25)
        values[f"actuator[{number + 1}].stiffness"] = f"{loose} N/m"
    return device.with_values(values), sensor_mass_kg


def doubts_about(device: Device, kind: str, seed: int) -> list[str]:
    """The doubts about one bar."""
    bar, sensor_mass_kg = truth_of(device, kind, seed)
    pairs = np.array(PAIRS_HZ[:5], dtype=np.float64)
    measured = simulate_measurements(bar, lay_out(pairs, even_places(bar), sensor_mass_kg), Flaws(NOISE), seed)
    measured.sensor_mass_kg[:] = SENSOR_MASS_KG  # what the file says
    found = calibrate(device, measured, default_names(device), Loss.ROBUST)
    report = calibration_report(found, None) | {"adequacy": adequacy_report(device, found, {})}
    return doubts_of(report)


def main() -> None:
    """Print, for each kind, how many bars are doubted."""
    options = read_options(__doc__, device=("reference-a",), draws=30)
    device = find_device(options.device)
    with threadpool_limits(1, "blas"):
        for kind in KINDS:
            doubted = sum(bool(doubts_about(device, kind, seed)) for seed in range(options.draws))
            print(f"{kind:10} {doubted} of {options.draws} doubted", flush=True)


if __name__ == "__main__":
    main()
