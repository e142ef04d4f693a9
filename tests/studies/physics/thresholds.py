"""Levels of clicks under another detection threshold curve: of the same clicks, and of clicks that are made for it.

    python -m tests.studies.physics.thresholds reference-a android

For every ordered pair of zones, one felt and one quiet, a click is made for the device's own curve and one for the
other curve. Both are evaluated under both curves on the same fresh plants. SIMULATED.
"""

import itertools
import sys

import numpy as np
from numpy.typing import NDArray

from engine.touch import Placement
from precompute.clicks import ClickSolver
from precompute.clicks.evaluation import evaluate_waveform
from tactable.shipped import find_device

RESIDUAL_S = 0.06
AIM_FELT_DB, AIM_QUIET_DB = 14.0, 1.0


def measure(name: str, other: str) -> NDArray[np.float64]:
    """Levels in dB (pair, curve it is made for, curve it is evaluated under, 2): 5 % felt and 95 % quiet."""
    device = find_device(name)
    solvers = [ClickSolver(each) for each in (device, device.with_threshold(other))]
    middles_m = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    found = []
    for first, second in itertools.combinations(range(len(middles_m)), 2):
        for roles in ((True, False), (False, True)):
            placement = Placement((middles_m[first], middles_m[second]), roles)
            fresh = [solver.plants_of(placement.position_m).evaluated for solver in solvers]
            levels = []
            for solver in solvers:
                waveform = solver.solve(placement).waveform
                seen = [evaluate_waveform(waveform, p, placement.felt, placement.quiet, RESIDUAL_S) for p in fresh]
                assert all(each.quiet is not None for each in seen)  # one finger of each pair is quiet
                levels.append([(each.felt.low_db, each.quiet.high_db) for each in seen if each.quiet])
            found.append(levels)
    return np.array(found)


def main() -> None:
    """Print how levels shift, and how many pairs reach the aim of the click bench, by the curve they are made for."""
    name, other = sys.argv[1:]
    names, levels = (find_device(name).threshold.name, other), measure(name, other)
    for made, made_for in enumerate(names):
        shift = levels[:, made, 1] - levels[:, made, 0]
        print(f"{name}, {len(levels)} clicks made for {made_for}, SIMULATED:")
        for role, row in zip(("felt", "quiet"), shift.T, strict=True):
            span = f"{row.min():+.2f} to {row.max():+.2f}"
            print(f"  {role}: {row.mean():+.2f} dB ({span}) under {other} against {names[0]}")
        for under, curve in enumerate(names):
            felt_db, quiet_db = levels[:, made, under].T
            reached = int(((felt_db >= AIM_FELT_DB) & (quiet_db <= AIM_QUIET_DB)).sum())
            print(
                f"  under {curve}: felt {felt_db.mean():.1f} dB ({felt_db.min():.1f} to {felt_db.max():.1f}), quiet "
                f"{quiet_db.mean():.1f} dB ({quiet_db.max():.1f} at most); {reached} of {len(levels)} with felt "
                f"{AIM_FELT_DB:g} and quiet {AIM_QUIET_DB:g}"
            )


if __name__ == "__main__":
    main()
