"""Temporal summation: a lasting sine keeps its level, a burst has what Zwislocki's theory leaves of it."""

import numpy as np
import pytest

from tactable.explain.summation import summed_db

RATE_HZ = 8_000.0


@pytest.mark.parametrize("length_s", [0.01, 0.03, 0.1, 0.4, 3.0])
def test_a_burst_counts_as_much_as_the_theory_says(length_s: float) -> None:
    time_s = np.arange(round(4 * RATE_HZ)) / RATE_HZ
    burst = np.where(time_s < length_s, 2.0 * np.sin(2 * np.pi * 400 * time_s), 0.0)
    theory_db = 20 * np.log10(2.0) + 10 * np.log10(1 - np.exp(-length_s / 0.2))
    assert summed_db(np.stack([burst, 10 * burst])[None], RATE_HZ)[0] == pytest.approx(
        [theory_db, theory_db + 20], abs=0.05
    )
