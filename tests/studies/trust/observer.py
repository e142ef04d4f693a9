"""How often the interval of a threshold holds the truth: simulated observers with lapses, fatigue and bias.

`python -m tests.studies.trust.observer [RUNS]` asks each of RUNS observers 80 trials of detection by QUEST+ and prints
the share whose threshold, at the middle of the trials, lies in the interval of 95 %, and how wide that is. SIMULATED.
"""

import random
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from tactable.experiment.observer import Observer, fits_of
from tactable.experiment.protocol import Kind, Task
from tests.studies.options import read_options

TASK = Task("t", Kind.DETECTION, (0.035,), "click", 0.0, tuple(np.arange(-14.0, 27.0).tolist()), None, 0.0, 80, 0, 8)
KINDS = {
    "steady": {"lapse": 0.0},
    "lapses": {"lapse": 0.06},
    "fatigue": {"fatigue": 2.0},
    "bias": {"bias": 0.2},
    "all of them": {"lapse": 0.05, "fatigue": 1.5, "bias": 0.15},
}


@dataclass(frozen=True)
class Recovery:
    """Of `runs` observers: how many intervals hold the truth, half of the interval and the error (dB)."""

    runs: int
    held: int
    half_db: float
    rms_db: float
    mean_db: float

    @property
    def share(self) -> tuple[float, float]:
        """Interval of 95 % of the share that is held, after Clopper and Pearson."""
        low = beta.ppf(0.025, self.held, self.runs - self.held + 1) if self.held else 0.0
        high = beta.ppf(0.975, self.held + 1, self.runs - self.held) if self.held < self.runs else 1.0
        return float(low), float(high)


def recover(kind: str, runs: int) -> Recovery:
    """Thresholds from -6 to 14 dB and slopes from 1.7 to 3.4, drawn for each run."""
    held, half_db, error_db = 0, [], []
    middle = (TASK.trials + TASK.catch - 1) / 2
    for run in range(runs):
        drawn = random.Random(f"{kind} {run}")
        slope = 1.7 * 2 ** drawn.random()
        observer = Observer(threshold=drawn.uniform(-6, 14), slope=slope, seed=run, **KINDS[kind])
        found, truth_db = fits_of(TASK, observer, str(run))[0].threshold, observer.threshold_db(TASK, middle)
        held += found.low <= truth_db <= found.high
        half_db.append((found.high - found.low) / 2)
        error_db.append(found.middle - truth_db)
    rms_db, mean_db = float(np.sqrt(np.mean(np.square(error_db)))), float(np.mean(error_db))
    return Recovery(runs, held, float(np.median(half_db)), rms_db, mean_db)


def main() -> None:
    """Print a row for each kind of observer."""
    runs = read_options(__doc__, runs=(100,)).runs
    for kind in KINDS:
        found = recover(kind, runs)
        low, high = found.share
        print(
            f"{kind:12} {found.held} of {runs} ({100 * low:.0f} to {100 * high:.0f} %), half of the interval "
            f"{found.half_db:.1f} dB, error {found.rms_db:.1f} dB rms, {found.mean_db:+.1f} dB mean"
        )


if __name__ == "__main__":
    main()
