"""Laws of the bound: above every drive of every family, settling on what a free mixture of drives reaches."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from precompute.entries.dual_bound import Columns, compute_bound, greatest_eigenvalue, peaks
from precompute.entries.objective import Problem
from precompute.entries.search import Search
from tests.precompute.entries.problems import random_drives, random_forms, random_problem, ratios

few = settings(deadline=None, max_examples=settings().max_examples // 3)
seeds = st.integers(0, 2**32 - 1)
counts = st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 3))
actuator_counts = st.integers(1, 3)
quantiles = st.sampled_from([None, 0.3, 0.9])
"""The levels that are wanted, of those sampled; None: no level is wanted."""


def sampled(problem: Problem, quantile: float | None, seed: int) -> tuple[float, float]:
    """A wanted level and the greatest sampled ratio above it, drives of every family."""
    ratio, level = ratios(problem, random_drives(problem, 3000, np.random.default_rng(seed)))
    wanted = 0.0 if quantile is None else float(np.quantile(level, quantile))
    return wanted, float(ratio[level >= wanted].max())


@few
@given(seeds, actuator_counts, counts, quantiles)
def test_no_drive_of_any_family_passes_the_bound_of_the_best(
    seed: int, actuators: int, sizes: tuple[int, int, int], quantile: float | None
) -> None:
    problem = random_problem(seed, actuators, sizes)
    wanted, greatest = sampled(problem, quantile, seed)
    found = Search(problem, [wanted]).best(wanted)
    assert found is not None
    assert greatest <= found.bound * (1 + 1e-6)
    assert found.drive.value <= found.bound * (1 + 1e-9)
    assert greatest <= compute_bound(problem, found.drive, wanted) * (1 + 1e-6)


@few
@given(seeds, actuator_counts, counts, quantiles)
def test_no_drive_of_any_family_passes_what_any_columns_prove(
    seed: int, actuators: int, sizes: tuple[int, int, int], quantile: float | None
) -> None:
    """Whatever the columns are, and in every round: each weight is a proof of its own."""
    problem = random_problem(seed, actuators, sizes)
    wanted, greatest = sampled(problem, quantile, seed)
    columns = Columns(problem, wanted)
    tone, place, amplitude = random_drives(problem, 300, np.random.default_rng(seed + 1))
    for k in np.flatnonzero(tone.max(axis=1) == 0)[:20]:
        columns.add(float(problem.frequency_hz[place[k, 0]]), amplitude[k])
    for _ in range(4):
        solved = columns.solve()
        if solved is None:  # no mixture of these is loud enough
            break
        assert greatest <= columns.price(solved[0]) * (1 + 1e-6)


@few
@given(seeds, actuator_counts, counts, quantiles)
def test_pricing_settles_where_the_mixture_reaches_the_bound(
    seed: int, actuators: int, sizes: tuple[int, int, int], quantile: float | None
) -> None:
    problem = random_problem(seed, actuators, sizes)
    wanted, greatest = sampled(problem, quantile, seed)
    columns = Columns(problem, wanted)
    drives = random_drives(problem, 3000, np.random.default_rng(seed))
    _, level = ratios(problem, drives)
    for k in np.flatnonzero((drives[0].max(axis=1) == 0) & (level >= wanted))[:5]:
        columns.add(float(problem.frequency_hz[drives[1][k, 0]]), drives[2][k])
    for k in range(len(problem.frequency_hz)):
        columns.add_single(k)
    reached, bound = 0.0, np.inf
    for _ in range(60):
        solved = columns.solve()
        assert solved is not None
        assert solved[1] >= reached * (1 - 1e-9)
        weights, reached = solved
        bound = min(bound, columns.price(weights))
        if bound <= reached * 1.001:
            break
    # The parabola over the frequencies, 20 Hz apart here, may promise what lies between them.
    assert reached <= bound * (1 + 1e-6)
    assert reached >= greatest * 0.999


@few
@given(seeds, actuator_counts)
def test_for_one_ratio_and_no_level_the_bound_is_the_greatest_eigenvalue(seed: int, actuators: int) -> None:
    problem = random_problem(seed, actuators, (1, 1, 1), frequencies=1)
    found = Search(problem, []).best(0.0)
    greatest = eigh(problem.numerator[0, 0], problem.denominator[0, 0], eigvals_only=True)[-1]
    assert found is not None
    assert found.bound == pytest.approx(greatest, rel=1e-3)
    assert found.drive.value == pytest.approx(greatest, rel=1e-3)


@few
@given(seeds, st.integers(2, 3))
def test_a_mixture_shares_all_actuators_among_two_or_more_tones(seed: int, actuators: int) -> None:
    problem = random_problem(seed, actuators, (3, 2, 2))
    columns = Columns(problem, 0.0)
    for k in range(len(problem.frequency_hz)):
        columns.add_single(k)
    for _ in range(6):
        solved = columns.solve()
        assert solved is not None
        columns.price(solved[0])
    for tones in columns.mixtures():
        assert 2 <= len(tones) <= actuators
        assert sorted(actuator for tone in tones for actuator in tone.actuators) == list(range(actuators))
        assert all(len(tone.amplitude) == len(tone.actuators) for tone in tones)


def test_an_actuator_out_of_band_everywhere_bounds_as_if_it_were_not_there() -> None:
    problem = random_problem(5, 3, (2, 2, 1))
    in_band = problem.in_band.copy()
    in_band[:, 2] = False
    mute = np.where(in_band[:, :, None] & in_band[:, None, :], 1.0, 0.0)
    fill = np.diag([0.0, 0.0, 1.0]) * problem.denominator.real.max()
    silent = replace(
        problem,
        in_band=in_band,
        numerator=problem.numerator * mute,
        denominator=problem.denominator * mute + fill,
        level=problem.level * mute,
    )
    two = replace(
        problem,
        in_band=in_band[:, :2],
        numerator=np.ascontiguousarray(problem.numerator[:, :, :2, :2]),
        denominator=np.ascontiguousarray(problem.denominator[:, :, :2, :2]),
        level=np.ascontiguousarray(problem.level[:, :, :2, :2]),
    )
    one, other = Search(silent, []).best(0.0), Search(two, []).best(0.0)
    assert one is not None and other is not None
    assert one.drive.amplitude[2] == 0
    assert one.drive.value == pytest.approx(other.drive.value, rel=2e-3)
    assert one.bound == pytest.approx(other.bound, rel=1e-2)


def test_peaks_are_the_local_maxima_that_are_not_negative_best_first() -> None:
    assert peaks(np.array([3.0, 1.0, 2.0, 2.0, -1.0, -0.5, -2.0, 5.0])) == [7, 0, 3]
    assert peaks(np.array([-1.0, -2.0])) == []
    assert peaks(np.array([0.0])) == [0]


@few
@given(seeds, actuator_counts, st.integers(1, 5))
def test_the_greatest_eigenvalue_is_scipys(seed: int, actuators: int, frequencies: int) -> None:
    random = np.random.default_rng(seed)
    numerator, denominator = (random_forms(random, 1, frequencies, actuators)[0] for _ in range(2))
    numerator = numerator - random.uniform() * np.eye(actuators)  # with a level, numerators are not definite
    expected = [eigh(n, d, eigvals_only=True)[-1] for n, d in zip(numerator, denominator, strict=True)]
    assert greatest_eigenvalue(numerator, denominator) == pytest.approx(expected, rel=1e-6, abs=1e-9)
