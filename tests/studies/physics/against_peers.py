"""Clicks on the plates of other works: what they published beside what ours give, with their actuators and with four.

    python -m tests.studies.physics.against_peers --placements 100

The plates are the device files of the folder `peers`, which say what was published. One finger feels and one is quiet,
anywhere at least 25 mm apart, as in `anywhere`, whose plants and percentiles these are. Contrast is what 95 % of the
plants feel at least, less what 95 % keep to under the quiet finger. SIMULATED: no figure of the two kinds was measured
on the same plate.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from precompute.clicks import DEFAULT_OPTIONS, ClickOptions
from precompute.parallel.pool import available_cores
from precompute.sampling.placements import Anywhere
from tactable.shipped import find_device
from tests.studies.options import read_options
from tests.studies.physics.anywhere import PLANTS, changed, compare_anywhere

FOLDER = Path(__file__).with_name("peers")
PUBLISHED = {
    "pantera-2020": "no contrast in the abstract; 83 and 92 % of patterns of two points told apart (EuroHaptics 2020)",
    "hudin-2015": "a peak of 7 µm on 20 mm², ultrasonic; no contrast in the abstract",
}
"""What was published of the contrast, by the name of the file."""
FEW = 4
_PERCENTS = (5, 50, 95)


def contrasts(
    name: str, placements: int, workers: int, options: ClickOptions = DEFAULT_OPTIONS, plants: int = PLANTS
) -> Iterator[dict[str, Any]]:
    """Figures of one plate: with its own actuators, then with FEW of them."""
    for count in (0, FEW):
        device = changed(find_device(str(FOLDER / f"{name}.toml")), "", count)
        found = compare_anywhere(device, Anywhere(placements), workers, options, plants=plants, is_brief=True)
        rows = [row["by_position"] for row in found["placements"]]
        contrast_db = [row["felt_db"]["low_db"] - row["quiet_db"]["high_db"] for row in rows]
        yield {
            "actuators": len(device.actuators),
            "contrast_db": np.percentile(contrast_db, _PERCENTS).tolist(),
            **{key: found["by_position"][key] for key in ("felt_db", "quiet_db", "share_that_keeps_the_aim")},
        }


def main() -> None:
    """Print what was published of each plate, then a line for each number of actuators."""
    asked = read_options(__doc__, placements=100)
    print(f"{asked.placements} placements of 1 felt and 1 quiet finger, SIMULATED: {_PERCENTS} % of them, dB")
    for name, published in PUBLISHED.items():
        device = find_device(str(FOLDER / f"{name}.toml"))
        print(f"{name}: {device.description}. Published: {published}")
        for row in contrasts(name, asked.placements, available_cores()):
            shown = (
                f"{key[:-3]} {' / '.join(f'{each:z.1f}' for each in row[key])}" for key in row if key[-3:] == "_db"
            )
            share = f"{100 * row['share_that_keeps_the_aim']:.0f} % felt and quiet"
            print(f"  {row['actuators']} actuators: {', '.join(shown)}, {share}", flush=True)
        print(f"  dB above the {device.threshold.title}; ESTIMATES: {', '.join(device.estimated_values)}")


if __name__ == "__main__":
    main()
