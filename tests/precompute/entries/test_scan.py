"""Laws of the scanning kernels: the best of everything that is scanned, by plain NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from precompute.entries.scan import scan, scan_pairs
from precompute.entries.search import pack_directions, pack_forms, search_directions
from tests.precompute.entries.problems import random_forms, random_problem

few = settings(deadline=None, max_examples=settings().max_examples // 3)
seeds = st.integers(0, 2**32 - 1)
counts = st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 3))
actuator_counts = st.integers(1, 4)


def random_drive(seed: int, actuators: int) -> NDArray[np.complex128]:
    parts = np.random.default_rng(seed).normal(size=(2, actuators))
    drive: NDArray[np.complex128] = parts[0] + 1j * parts[1]
    return drive


@few
@given(seeds, actuator_counts)
def test_the_product_of_packed_form_and_packed_direction_is_the_power(seed: int, actuators: int) -> None:
    forms = random_forms(np.random.default_rng(seed), 2, 3, actuators)
    directions = np.array([random_drive(seed + k, actuators) for k in range(5)]).T
    found = pack_forms(forms) @ pack_directions(directions)
    expected = np.einsum("ad,ifab,bd->ifd", directions.conj(), forms, directions).real
    assert abs(found - expected).max() <= 1e-5 * abs(expected).max()


@few
@given(seeds, actuator_counts, counts)
def test_the_scan_finds_the_best_direction_above_each_level(
    seed: int, actuators: int, sizes: tuple[int, int, int]
) -> None:
    problem, directions = random_problem(seed, actuators, sizes), search_directions(actuators)
    single = [np.einsum("ad,ifab,bd->ifd", directions.conj(), s, directions).real for s in problem.stacks]
    ratio, loud = single[0].min(axis=0) / single[1].max(axis=0), single[2].min(axis=0)
    wanted = np.quantile(loud, [0.0, 0.5, 0.99]).astype(np.float32)
    wanted[0] = 0.0
    score = np.empty((len(problem.frequency_hz), 4), dtype=np.float32)
    arg = np.empty(score.shape, dtype=np.int64)
    numerator, denominator, level = map(pack_forms, problem.stacks)
    scan(numerator, denominator, level, pack_directions(directions), wanted, score, arg)
    at = np.arange(len(score))
    for w, level in enumerate(wanted):
        # A direction at the very level may fall on either side of it in single precision.
        surely, perhaps = (np.where(loud >= level * (1 + e), ratio, -1.0).max(axis=1) for e in (1e-5, -1e-5))
        assert (score[:, w] >= surely - 1e-4 * abs(surely)).all() and (
            score[:, w] <= perhaps + 1e-4 * abs(perhaps)
        ).all()
        reached = score[:, w] >= 0
        assert score[reached, w] == pytest.approx(ratio[at, arg[:, w]][reached], rel=1e-4)
        assert (loud[at, arg[:, w]][reached] >= level * (1 - 1e-5)).all()
    assert score[:, 3] == pytest.approx(loud.max(axis=1), rel=1e-5)
    assert loud[at, arg[:, 3]] == pytest.approx(loud.max(axis=1), rel=1e-5)


@few
@given(seeds, counts, st.sampled_from([0.0, 0.5, 5.0]))
def test_the_scan_of_pairs_finds_the_best_second_tone_and_its_power(
    seed: int, sizes: tuple[int, int, int], wanted: float
) -> None:
    random, hz = np.random.default_rng(seed), np.array([60.0, 66.0, 75.0, 130.0])
    first, second = 10 ** random.uniform(-1, 1, (2, len(hz), sum(sizes) + 2))
    first[:, -1], second[:, -2] = 0, 0  # an actuator each
    shares, ends = np.geomspace(0.1, 10, 7), np.cumsum(sizes)
    best, partner, share = np.empty(len(hz)), np.empty(len(hz), dtype=np.int64), np.empty(len(hz))
    scan_pairs(first, second, hz, shares, ends, wanted, 10.0, best, partner, share)

    def judged(shares: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Ratio, and how far above what is wanted the level is (first, second, share); no ratio where tones beat."""
        total = first[:, None, None] + shares[:, None] * second[:, None]
        numerator, denominator, level, actuator = np.split(total, ends, axis=-1)
        ratio = numerator.min(axis=-1) / denominator.max(axis=-1)
        ratio[abs(hz[:, None] - hz) < 10.0] = -1.0
        return ratio, level.min(axis=-1) - wanted * actuator.max(axis=-1)

    ratio, spare = judged(shares)
    assert (best >= np.where(spare >= 0, ratio, -1.0).max(axis=(1, 2)) - 1e-9).all()
    for f in np.flatnonzero(best >= 0):
        of_found, spare_of_found = (each[f, partner[f], 0] for each in judged(share[f : f + 1]))
        assert of_found == pytest.approx(best[f])
        assert spare_of_found >= -1e-9
        assert share[f] in shares or spare_of_found == pytest.approx(0.0, abs=1e-9)
    many, spare = judged(np.geomspace(1e-3, 1e3, 5000))
    assert (np.where(spare > 0, many, -1.0).max(axis=(1, 2))[best < 0] < 0).all()
