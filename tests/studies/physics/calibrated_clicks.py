"""What a calibration brings for clicks: the spread of the bar shrinks to what the measurements leave.

    python -m tests.studies.physics.calibrated_clicks reference-a [PLACEMENTS]

A bar that differs from its description is measured (five drives at 22 points, 1 % noise) and fitted. Clicks of random
placements of one felt and one quiet finger (± 1 mm) are then made for three states of knowledge: the described bar
within its [spread], the fitted bar as the calibration leaves it, and the described bar known exactly. Each is evaluated
on fresh plants of its own spread; fingers vary as the device file says. SIMULATED.
"""

from dataclasses import replace

import numpy as np

from base.arrays import Array
from engine.device import Device
from precompute.calibration.calibrate import calibrate
from precompute.calibration.device_text import calibrated_device
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.measurements.parameters import default_names
from precompute.measurements.simulate import Flaws
from precompute.sampling.placements import Anywhere, random_placements
from tactable.shipped import find_device
from tests.precompute.measured import PAIRS_HZ, TRUTH, read_bar
from tests.studies.options import read_options

_PERCENTS = (5, 50, 95)


def calibrated(device: Device, names: tuple[str, ...]) -> Device:
    """The device as fitted to simulated measurements of a bar that differs from it."""
    measured = read_bar(device, TRUTH, PAIRS_HZ[:5], flaws=Flaws(noise=0.01))
    return calibrated_device(calibrate(device, measured, names, starts=1))


def felt_db(device: Device, placements: int) -> Array:
    """Felt level of 5 % and quiet level of 95 % of the plants (2, placement)."""
    wanted = Anywhere(placements=placements, seed=11)
    solver = ClickSolver(device, replace(DEFAULT_OPTIONS, tolerance_m=1e-3))
    found = [solver.solve(placement).evaluation for placement in random_placements(device, wanted)]
    return np.array([(each.felt.low_db, each.quiet.high_db if each.quiet else np.nan) for each in found]).T


def main() -> None:
    """Print a row for each state of knowledge."""
    asked = read_options(__doc__, device=("reference-a",), placements=(60,))
    device = find_device(asked.device)
    exact = replace(device, spread=replace(device.spread, stiffness=0.0, mass=0.0))
    names = default_names(device)
    known = {
        "described": device,
        "fitted as usual": calibrated(device, names),
        "fitted with bar.density and actuator.mass": calibrated(device, (*names, "bar.density", "actuator.mass")),
        "known exactly": exact,
    }
    what = f"{asked.device}, {asked.placements} random placements of two fingers, SIMULATED"
    print(f"{what}: felt (5 %), quiet (95 %) in dB")
    for words, bar in known.items():
        felt, quiet = felt_db(bar, asked.placements)
        shown = " / ".join(f"{level:.1f}" for level in np.percentile(felt, _PERCENTS))
        print(f"{words}: felt mean {felt.mean():.2f} (5/50/95 % of placements: {shown}); quiet mean {quiet.mean():.2f}")


if __name__ == "__main__":
    main()
