"""Coverage of the 95 % intervals of a calibration on synthetic bars with known parameters. SIMULATED.

`python -m tests.studies.physics.calibration_coverage [--draws N] [--figure FILE]` proves that the intervals
hold the true value about as often as they say, with noise and with wrong readings, and that without noise the fit is
exact. docs/calibration-coverage.png and the table in docs/calibration.md are made with --draws 100.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from base.arrays import Array, Mask
from engine.device import Device
from precompute.calibration.calibrate import Known, calibrate
from precompute.measurements.model import Flaws, even_places, simulate_measurements
from precompute.measurements.parameters import find_parameters, paper_names, with_changes
from precompute.measurements.types import lay_out
from tactable.shipped import find_device
from tests.precompute.measured import PAIRS_HZ, SENSOR_MASS_KG
from tests.studies.options import read_options


@dataclass(frozen=True)
class Case:
    """Bars like `device`, `pairs` drives read at 22 points; `published`: sigma is the published one, next to 0."""

    device: str
    pairs: int
    noise: float
    wrong: float = 0.0
    published: bool = False


CASES = (
    *(Case(*each) for each in product(("reference-a", "reference-d"), (3, 5, 7), (0, 0.01, 0.05))),
    *(Case("reference-a", 5, noise, published=True) for noise in (0.01, 0.05)),
    *(Case("reference-a", 5, noise, 0.1) for noise in (0, 0.01)),
)


def measure_coverage(cases: Sequence[Case], draws: int) -> dict[str, Any]:
    """Every case with `draws` bars; the draws of a case depend on nothing but their number."""
    with threadpool_limits(1, "blas"):
        return {"draws": draws, "cases": [_run_case(case, draws) for case in cases]}


def _run_case(case: Case, draws: int) -> dict[str, Any]:
    found = [_run_draw(case, seed) for seed in range(draws)]
    error, held, wide, seconds = (np.array(column) for column in zip(*found, strict=True))
    return {
        **asdict(case),
        "parameters": [
            {
                "name": name,
                "median_error": float(np.median(error[:, i])),
                "greatest_error": float(error[:, i].max()),
                "held": float(held[:, i].mean()),
                "open": float(wide[:, i].mean()),
            }
            for i, name in enumerate(paper_names(find_device(case.device)))
        ],
        "held": float(held.mean()),
        "seconds": {"median": float(np.median(seconds)), "greatest": float(seconds.max())},
    }


def _run_draw(case: Case, seed: int) -> tuple[Array, Mask, Mask, float]:
    """Relative errors (parameter,), whether intervals hold the true values, whether they are wide, and time in s."""
    device = find_device(case.device)
    names = paper_names(device)
    truth = draw_truth(device, names, seed, published=case.published)
    layout = lay_out(np.array(PAIRS_HZ[: case.pairs]), even_places(device), SENSOR_MASS_KG)
    bar = with_changes(device, dict(zip(names, truth.tolist(), strict=True)))
    measured = simulate_measurements(bar, layout, Flaws(case.noise, case.wrong), seed)
    start = time.perf_counter()
    found = calibrate(device, measured, names)
    seconds = time.perf_counter() - start
    value, low, high = np.array([(e.value, e.low, e.high) for e in found.estimates]).T
    held = (low <= truth * (1 + 1e-9)) & (truth <= high * (1 + 1e-9))
    wide = np.array([e.known not in (Known.WELL, Known.ROUGHLY) for e in found.estimates])
    return np.abs(value / truth - 1), held, wide, seconds


def draw_truth(device: Device, names: Sequence[str], seed: int, *, published: bool) -> Array:
    """Values (parameter,), SI: stiffness within 30 % of the description, full scale 40 %, damping a factor of e."""
    random = np.random.default_rng(seed)
    out = []
    for parameter in find_parameters(device, names, {}, 0.0):
        factor = {
            "stiffness": random.uniform(0.75, 1.3),
            "full_scale": random.uniform(0.7, 1.4),
            "damping": np.exp(random.uniform(-1, 1)),
            "stiffness_damping": np.exp(random.uniform(-1, 1)),
            "mass_damping": 1.0 if published else np.exp(random.uniform(np.log(0.3), np.log(10))) / parameter.start,
        }[parameter.key]
        out.append(parameter.start * float(factor))
    return np.array(out)


def describe(row: dict[str, Any]) -> str:
    """One line on a case."""
    worst = max(p["greatest_error"] for p in row["parameters"] if p["name"] != "bar.mass_damping")
    return (
        f"{_title(row):60} held {100 * row['held']:5.1f} %, worst error without sigma {worst:.1e}, "
        f"{row['seconds']['median']:.2f} s (at most {row['seconds']['greatest']:.2f})"
    )


def _title(row: dict[str, Any]) -> str:
    return (
        f"{row['device']}, {row['pairs']} pairs, {100 * row['noise']:g} %"
        + (f", {100 * row['wrong']:g} % wrong" if row["wrong"] else "")
        + (", sigma as published" if row["published"] else "")
    )


def draw(result: dict[str, Any], path: Path) -> None:
    """Share of intervals that hold the true value, by parameter and case with noise."""
    cases = [row for row in result["cases"] if row["noise"] > 0]
    figure = Figure(figsize=(10, 1.6 + 0.33 * len(cases)), layout="constrained")
    axes = figure.add_subplot()
    for height, row in enumerate(reversed(cases)):
        for i, parameter in enumerate(row["parameters"]):
            marker = "os^vDP"[i % 6]
            axes.plot(100 * parameter["held"], height, marker, ms=5, alpha=0.7, color=f"C{i}")
        axes.plot(100 * row["held"], height, "|", ms=14, mew=2, color="black")
    axes.axvspan(90, 98, color="grey", alpha=0.2, lw=0)
    axes.set_yticks(range(len(cases)), [_title(row) for row in reversed(cases)], fontsize="small")
    axes.set_xlabel("intervals of 95 % that hold the true value (%); | is the mean of the parameters")
    for i, parameter in enumerate(cases[0]["parameters"]):
        axes.plot([], [], "os^vDP"[i % 6], color=f"C{i}", label=parameter["name"])
    axes.legend(fontsize="small", loc="upper left")
    figure.suptitle(f"SIMULATED bars with known parameters, {result['draws']} of each case", fontsize="medium")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print a line for each case."""
    asked = read_options(__doc__, draws=10, figure="")
    result = measure_coverage(CASES, asked.draws)
    if asked.figure:
        draw(result, Path(asked.figure))
    print("\n".join(map(describe, result["cases"])))


if __name__ == "__main__":
    main()
