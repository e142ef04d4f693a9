"""What a click loses that was made for the nearest place of a grid, by the pitch of the grid.

    python -m tests.studies.physics.pitch reference-a
    python -m tests.studies.physics.pitch reference-a.nc    # the clicks of a built table
    python -m tests.studies.physics.pitch reference-p --placements 40    # a plate, whose places lie on a grid both ways

For random placements of one felt and one quiet finger, the click made for their own positions (± 1 mm) is compared with
the one made for the nearest places of a grid, for fingers within half a pitch and 1 mm of them. Both are evaluated on
the same fresh plants at the real positions. SIMULATED.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from base.arrays import Array
from engine.table import Table
from engine.touch.places import Places
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.sampling.placements import Anywhere, random_placements
from tactable.shipped import find_device
from tests.studies.options import read_options
from tests.studies.physics.anywhere import PLANTS, TOLERANCE_M, evaluate_as_it_is

PITCHES_MM = (2.0, 3.0, 4.0, 5.0, 7.5, 10.0)
_PERCENTS = (50, 95, 100)


def measure(name: str, placements: int) -> dict[float, Array]:
    """By pitch in mm: loss of the felt level (5 %) and gain of the quiet level (95 %) in dB, (2, placement)."""
    device, wanted = find_device(name), Anywhere(placements=placements, seed=7)
    options = replace(DEFAULT_OPTIONS, tolerance_m=TOLERANCE_M, judged=PLANTS)
    own, drawn = ClickSolver(device, options), random_placements(device, wanted)
    best = [own.solve(placement).evaluation for placement in drawn]
    found = dict[float, Array]()
    for pitch_mm in PITCHES_MM:
        places = Places.every(device.surface.corner_m, pitch_mm / 1e3)
        solver = ClickSolver(device, replace(options, tolerance_m=places.pitch_m / 2 + TOLERANCE_M))
        changes = list[tuple[float, float]]()
        for placement, exact in zip(drawn, best, strict=True):
            click = solver.solve(places.placement(places.key(placement)))
            near = evaluate_as_it_is(own, placement, click.waveform)
            assert near.quiet is not None and exact.quiet is not None  # there is a quiet finger in each
            changes.append((exact.felt.low_db - near.felt.low_db, near.quiet.high_db - exact.quiet.high_db))
        found[pitch_mm] = np.array(changes).T
    return found


def measure_table(path: Path, placements: int) -> dict[float, Array]:
    """As `measure`, of the clicks that a table holds for the nearest places."""
    wanted = Anywhere(placements=placements, seed=7)
    with Table.open(path, verify=False) as table:
        solver = ClickSolver(table.device, replace(DEFAULT_OPTIONS, tolerance_m=TOLERANCE_M, judged=PLANTS))
        changes = list[tuple[float, float]]()
        for placement in random_placements(table.device, wanted):
            exact, click = solver.solve(placement).evaluation, table.click_at(placement, np.inf)
            assert click is not None and exact.quiet is not None  # every pair is tabulated; one finger is quiet
            near = evaluate_as_it_is(solver, placement, click.samples.T / SAMPLE_FULL_SCALE)
            assert near.quiet is not None
            changes.append((exact.felt.low_db - near.felt.low_db, near.quiet.high_db - exact.quiet.high_db))
    return {1e3 * table.places.pitch_m: np.array(changes).T}


def main() -> None:
    """Print a row for each pitch."""
    asked = read_options(__doc__, device=("reference-a",), placements=100)
    name, placements = asked.device, asked.placements
    found = measure_table(Path(name), placements) if name.endswith(".nc") else measure(name, placements)
    print(f"{name}, {placements} random placements, SIMULATED: mean, then 50, 95 and 100 % of the placements, dB")
    for pitch_mm, (loss_db, gain_db) in found.items():
        rows = (("felt less", loss_db), ("quiet more", gain_db))
        shown = (
            f"{kind} {each.mean():.2f} ({', '.join(f'{p:.2f}' for p in np.percentile(each, _PERCENTS))})"
            for kind, each in rows
        )
        print(f"pitch {pitch_mm:.3g} mm: {'; '.join(shown)}")


if __name__ == "__main__":
    main()
