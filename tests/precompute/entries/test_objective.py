"""Laws of the objectives: each is its definition at every drive, silent outside the bands, blind to amplitude."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from engine.touch import ZoneState
from precompute.entries.objective import (
    OBJECTIVES,
    QUIET_FLOOR,
    Problem,
    contrast,
    fair_share,
    level,
    localized_factor,
    paper,
    standard_contrast,
)
from precompute.predict.forms import Forms
from tests.precompute.entries.problems import random_drives, random_forms, random_problem, ratios

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
States = tuple[ZoneState, ...]
few = settings(deadline=None, max_examples=settings().max_examples // 3)
seeds = st.integers(0, 2**32 - 1)
actuator_counts = st.integers(1, 3)
FREE, QUIET, FELT = ZoneState
ZONES, FREQUENCIES = 4, 5


def states_with(*kinds: ZoneState) -> st.SearchStrategy[States]:
    """Four zones, at least one of them felt and one in each of `kinds`."""
    states = st.tuples(*[st.sampled_from(ZoneState)] * ZONES)
    return states.filter(lambda found: {FELT, *kinds} <= set(found))


def random_state_forms(seed: int, actuators: int, states: States) -> Forms:
    """Forms that are no bar's: zones of random energy, and 1.3 times their sum in the whole."""
    random, touched = np.random.default_rng(seed), tuple(z for z, state in enumerate(states) if state is not FREE)
    energy, untouched = (random_forms(random, ZONES, FREQUENCIES, actuators) for _ in range(2))
    return Forms(
        touched=touched,
        frequency_hz=60 + 20 * np.arange(float(FREQUENCIES)),
        level=random_forms(random, len(touched), FREQUENCIES, actuators),
        expected=random_forms(random, len(touched), FREQUENCIES, actuators),
        energy=energy,
        total=1.3 * energy.sum(axis=0),
        bar_mean=random_forms(random, 1, FREQUENCIES, actuators)[0],
        untouched_energy=untouched,
        untouched_total=1.2 * untouched.sum(axis=0),
        in_band=np.ones((FREQUENCIES, actuators), dtype=bool),
    )


def coherent_powers(forms: Complex, f: int, drive: Complex) -> Array:
    """a^H H a of each form at the f-th frequency."""
    power: Array = np.einsum("a,iab,b->i", drive.conj(), forms[:, f], drive).real
    return power


def fingers(forms: Forms, states: States, kind: ZoneState) -> list[int]:
    return [finger for finger, zone in enumerate(forms.touched) if states[zone] is kind]


def zones(states: States, kind: ZoneState) -> list[int]:
    return [zone for zone, state in enumerate(states) if state is kind]


def judged(problem: Problem, f: int, drive: Complex) -> tuple[float, float]:
    """Ratio and weakest level of a coherent drive."""
    numerator, denominator, loud = (coherent_powers(stack, f, drive) for stack in problem.stacks)
    return numerator.min() / denominator.max(), loud.min(initial=np.inf)


def some_drive(seed: int, actuators: int) -> Complex:
    parts = np.random.default_rng(seed).normal(size=(2, actuators))
    drive: Complex = parts[0] + 1j * parts[1]
    return drive


@few
@given(seeds, actuator_counts, states_with(QUIET))
def test_contrast_is_the_weakest_felt_over_the_strongest_quiet_finger(
    seed: int, actuators: int, states: States
) -> None:
    forms, drive = random_state_forms(seed, actuators, states), some_drive(seed, actuators)
    expected = coherent_powers(forms.expected, 2, drive)
    wanted = expected[fingers(forms, states, FELT)].min() / expected[fingers(forms, states, QUIET)].max()
    ratio, loud = judged(contrast(forms, states), 2, drive)
    assert ratio == pytest.approx(wanted)
    standard = coherent_powers(forms.level, 2, drive)
    floor = QUIET_FLOOR * coherent_powers(forms.bar_mean[None], 2, drive)[0]
    wanted = standard[fingers(forms, states, FELT)].min() / (standard[fingers(forms, states, QUIET)].max() + floor)
    assert judged(standard_contrast(forms, states), 2, drive)[0] == pytest.approx(wanted)
    assert loud == pytest.approx(coherent_powers(forms.level, 2, drive)[fingers(forms, states, FELT)].min())


@few
@given(seeds, actuator_counts, states_with().filter(lambda states: QUIET not in states))
def test_with_nothing_quiet_contrast_is_the_localized_factor(seed: int, actuators: int, states: States) -> None:
    forms, drive = random_state_forms(seed, actuators, states), some_drive(seed, actuators)
    problem = contrast(forms, states)
    assert problem.name == "localized factor" and problem.is_share
    assert judged(problem, 1, drive) == pytest.approx(judged(localized_factor(forms, states), 1, drive))


@few
@given(seeds, actuator_counts, states_with())
def test_shares_are_energies_over_the_whole_bars(seed: int, actuators: int, states: States) -> None:
    forms, drive = random_state_forms(seed, actuators, states), some_drive(seed, actuators)
    felt = coherent_powers(forms.energy, 3, drive)[zones(states, FELT)]
    total = coherent_powers(forms.total[None], 3, drive)[0]
    assert judged(localized_factor(forms, states), 3, drive)[0] == pytest.approx(felt.sum() / total)
    assert judged(fair_share(forms, states), 3, drive)[0] == pytest.approx(felt.min() / total)


@few
@given(seeds, actuator_counts, states_with())
def test_the_papers_objective_is_the_share_without_fingers_whatever_the_level(
    seed: int, actuators: int, states: States
) -> None:
    forms, drive = random_state_forms(seed, actuators, states), some_drive(seed, actuators)
    felt = coherent_powers(forms.untouched_energy, 3, drive)[zones(states, FELT)].sum()
    share = felt / coherent_powers(forms.untouched_total[None], 3, drive)[0]
    ratio, loud = judged(paper(forms, states), 3, drive)
    assert ratio == pytest.approx(share)
    assert loud == np.inf


@few
@given(seeds, actuator_counts, states_with())
def test_level_is_the_weakest_felt_fingers_at_full_scale(seed: int, actuators: int, states: States) -> None:
    forms, drive = random_state_forms(seed, actuators, states), some_drive(seed, actuators)
    felt = coherent_powers(forms.level, 0, drive / abs(drive).max())[fingers(forms, states, FELT)]
    assert judged(level(forms, states), 0, drive)[0] == pytest.approx(felt.min())


@few
@given(seeds, st.integers(2, 3))
def test_a_muted_actuator_adds_nothing_outside_its_band(seed: int, actuators: int) -> None:
    problem = random_problem(seed, actuators, (2, 3, 2))
    in_band = np.random.default_rng(seed).uniform(size=problem.in_band.shape) < 0.6
    part = replace(problem, in_band=in_band).muted()
    drives = random_drives(part, 200, np.random.default_rng(seed))  # silent where they are out of band
    for mine, other in zip(ratios(part, drives), ratios(problem, drives), strict=True):
        assert mine == pytest.approx(other)
    for f, inside in enumerate(in_band):
        drive = some_drive(seed + f, actuators)
        if inside.any():
            ratio, loud = judged(part, f, drive)
            assert ratio <= judged(part, f, np.where(inside, drive, 0))[0] * (1 + 1e-9)
            assert loud == pytest.approx(judged(part, f, np.where(inside, drive, 0))[1])


def test_some_frequencies_of_a_problem_are_the_problem_there() -> None:
    problem, chosen = random_problem(3, 2, (2, 1, 1)), np.array([1, 4, 7])
    few = problem.at(chosen)
    assert few.frequency_hz.tolist() == problem.frequency_hz[chosen].tolist()
    for mine, whole in zip(few.stacks, problem.stacks, strict=True):
        assert (mine == whole[:, chosen]).all()


@few
@given(seeds, actuator_counts, states_with())
@pytest.mark.parametrize("name", OBJECTIVES)
def test_a_ratio_does_not_depend_on_the_amplitude(name: str, seed: int, actuators: int, states: States) -> None:
    forms, drive = random_state_forms(seed, actuators, states), some_drive(seed, actuators)
    problem = OBJECTIVES[name](forms, states)
    assert judged(problem, 0, 1e-3j * drive)[0] == pytest.approx(judged(problem, 0, drive)[0])


@few
@given(seeds, actuator_counts, states_with())
def test_only_the_share_of_all_zones_of_a_covered_bar_is_flat(seed: int, actuators: int, states: States) -> None:
    gaps = random_state_forms(seed, actuators, states)
    covered = replace(gaps, total=gaps.energy.sum(axis=0))
    assert contrast(covered, states).is_flat == (set(states) == {FELT})
    assert not contrast(gaps, states).is_flat
    assert not level(covered, states).is_flat
