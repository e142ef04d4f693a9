"""What clicks lose where one channel is late, before and after a calibration has found its delay. SIMULATED.

    python -m tests.studies.physics.late_channel reference-a

The last channel is late. Responses at 8 places and 25 frequencies, with 2 % of noise, are fitted without and with the
delays. Clicks are made for the device file and for both fits, and evaluated on fresh plants of the late bar.
"""

from dataclasses import replace

import numpy as np

from engine.device import Device
from precompute.calibration.calibrate import calibrate
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.measurements.model import Flaws
from precompute.measurements.parameters import default_names, with_changes
from precompute.measurements.types import Kind
from precompute.sampling.placements import Anywhere, random_placements
from tactable.shipped import find_device
from tests.precompute.measured import read_bar
from tests.studies.options import read_options
from tests.studies.physics.anywhere import TOLERANCE_M, contrast_cells, kept_share


def late_device(device: Device, late_s: float) -> Device:
    """The device, its last channel late by this."""
    return with_changes(device, {f"actuator[{len(device.actuators)}].delay": late_s})


def calibrated(device: Device, true: Device, *, with_delays: bool) -> tuple[Device, list[str]]:
    """The device with what a fit to responses of the true one gives, and the delays that it finds, in words."""
    count = len(device.actuators)
    hz = np.arange(60.0, 301.0, 10.0)
    drives_hz = np.concatenate([np.where(np.arange(count) == i, hz[:, None], np.nan) for i in range(count)])
    read = read_bar(true, {}, drives_hz.tolist(), Flaws(noise=0.02), points=8, kind=Kind.RESPONSE)
    delays = tuple(f"actuator[{i}].delay" for i in range(1, count + 1)) if with_delays else ()
    found = calibrate(device, read, (*default_names(device), *delays), starts=2)
    told = [
        f"{each.parameter.name} {1e6 * each.value:.1f} us ({1e6 * each.low:.1f} to {1e6 * each.high:.1f})"
        for each in found.estimates
        if each.parameter.name in delays
    ]
    return found.device, [f"noise {100 * found.noise:.1f} %", *told]


def compare_late(
    true: Device, believed: dict[str, Device], wanted: Anywhere, options: ClickOptions = DEFAULT_OPTIONS
) -> dict[str, list[tuple[float, float]]]:
    """(felt 5 %, quiet 95 %) in dB of every placement, on plants of the true device, by what clicks are made for."""
    options = replace(options, tolerance_m=TOLERANCE_M)
    judge = ClickSolver(true, options)
    solvers = {name: ClickSolver(device, options) for name, device in believed.items()}
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in believed}
    for placement in random_placements(true, wanted):
        for name, solver in solvers.items():
            figures = judge.evaluate(placement, solver.solve(placement).waveform.T)
            assert figures.quiet is not None
            found[name].append((figures.felt.low_db, figures.quiet.high_db))
    return found


def main() -> None:
    """Compare at some delays."""
    asked = read_options(__doc__, device=str, placements=60, late="0,50,125")
    device = find_device(asked.device)
    print("| late by, µs | clicks made for | contrast (5, 50 %), dB | quiet (50, 95 %), dB | felt ≥ 14, quiet ≤ 1 |")
    print("|---|---|---|---|---|")
    for late_us in map(float, asked.late.split(",")):
        true = late_device(device, 1e-6 * late_us)
        without, told_without = calibrated(device, true, with_delays=False)
        with_them, told = calibrated(device, true, with_delays=True)
        believed = {"the file": device, "a fit without delays": without, "a fit with delays": with_them}
        for name, pairs in compare_late(true, believed, Anywhere(placements=asked.placements)).items():
            felt_db, quiet_db = np.array(pairs).T
            kept = f"{100 * kept_share(felt_db, quiet_db):.0f} %"
            print(f"| {late_us:g} | {name} | {contrast_cells(pairs)} | {kept} |", flush=True)
        print(f"fits: {', '.join(told_without)}; {', '.join(told)}")


if __name__ == "__main__":
    main()
