"""What each set of spreads costs: felt level of clicks at positions, at quiet levels of 1 and 6 dB, by device.

    python -m tests.studies.physics.spread_price

Random pairs 25 mm apart, one felt; 5 % of the sampled plants below the felt level, 95 % below the quiet one. SIMULATED.
"""

from dataclasses import replace

import numpy as np

from base.arrays import Array
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.sampling.placements import Anywhere, random_placements
from tests.precompute.devices import shipped
from tests.studies.physics.anywhere import kept_share

DEVICES = ("reference-a", "reference-d", "reference-t", "reference-c", "reference-p")
SETS = ("bench", "lab", "hand")
ALLOWED_DB = (0.4, 5.4)  # quiet levels asked for, whose 95th percentiles on other plants are below 1 and 6 dB


def felt_and_quiet(name: str, spread: str, quiet_db: float, placements: int = 50) -> Array:
    """Shape (placement, 2): felt level in 5 %, quiet level in 95 % of the plants."""
    device = shipped(name).with_values({"spread": spread})
    solver = ClickSolver(device, replace(DEFAULT_OPTIONS.at_fingers, quiet_db=quiet_db, judged=400))
    found = list[tuple[float, float]]()
    for placement in random_placements(device, Anywhere(placements, seed=34)):
        click = solver.solve(placement)
        assert click.quiet is not None
        found.append((click.felt.low_db, click.quiet.high_db))
    return np.array(found)


def main() -> None:
    """Print the table."""
    print("felt in dB, 5 / 50 / 95 % of 50 placements, and how many of them keep felt >= 14 dB and the quiet level")
    for name in DEVICES:
        count = len(shipped(name).actuators)
        for spread in SETS:
            cells = list[str]()
            for quiet_db, most_db in zip(ALLOWED_DB, (1.0, 6.0), strict=True):
                felt, quiet = felt_and_quiet(name, spread, quiet_db).T
                levels = " / ".join(f"{level_db:.1f}" for level_db in np.percentile(felt, [5, 50, 95]))
                kept, is_quiet = 100 * kept_share(felt, quiet, most_db), 100 * np.mean(quiet <= most_db)
                cells.append(f"{levels}, {kept:.0f} % ({is_quiet:.0f} % quiet)")
            print(f"| `{name}`, {count} | {spread} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
