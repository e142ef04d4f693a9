"""Laws of a found drive: full scale, the wire's frequencies, a family by its tones, figures those of the problem."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from precompute.entries.found_drive import FoundDrive, evaluate_drive, full_scale
from tests.precompute.entries.problems import random_drives, random_problem, ratios

Complex = NDArray[np.complex128]
few = settings(deadline=None, max_examples=settings().max_examples // 3)
seeds = st.integers(0, 2**32 - 1)
actuator_counts = st.integers(1, 4)


def judged(seed: int, actuators: int, drive: int = 0) -> tuple[FoundDrive, float, float]:
    """One of the random drives of a random problem, judged, and the ratio and level that NumPy finds."""
    problem, random = random_problem(seed, actuators, (2, 3, 2)), np.random.default_rng(seed)
    drives = random_drives(problem, drive + 1, random)
    _, place, amplitude = drives
    found = evaluate_drive(
        problem, problem.frequency_hz[place[drive]], amplitude[drive], random.uniform(size=7 + actuators)
    )
    ratio, level = ratios(problem, drives)
    return found, float(ratio[drive]), float(level[drive])


@few
@given(seeds, actuator_counts)
def test_value_and_loudness_are_the_problems(seed: int, actuators: int) -> None:
    found, ratio, level = judged(seed, actuators)
    assert found.value == pytest.approx(ratio)
    assert found.loudness == pytest.approx(level)


@few
@given(seeds, actuator_counts)
def test_weights_are_finite_and_none_is_negative(seed: int, actuators: int) -> None:
    weights = judged(seed, actuators)[0].weights
    for part in (weights.numerator, weights.denominator, weights.level, weights.actuator):
        assert np.isfinite(part).all() and (part >= 0).all()


@few
@given(seeds, st.integers(1, 5), st.floats(1e-6, 1e6))
def test_full_scale_is_the_same_drive_with_its_strongest_at_one_and_its_first_at_phase_zero(
    seed: int, actuators: int, scale: float
) -> None:
    parts = np.random.default_rng(seed).normal(size=(2, actuators)) * scale
    drive = parts[0] + 1j * parts[1]
    found = full_scale(drive)
    assert abs(found).max() == pytest.approx(1.0)
    assert found[0].imag == pytest.approx(0.0, abs=1e-12) and found[0].real > 0
    assert np.outer(found, drive) == pytest.approx(np.outer(drive, found), abs=1e-9 * scale)
    assert full_scale(found) == pytest.approx(found)


def test_what_is_a_billionth_of_the_strongest_is_silence() -> None:
    found = full_scale(np.array([1e-12, 2j, 1.0]))
    assert found.tolist() == pytest.approx([0.0, 1.0, -0.5j])


@pytest.mark.parametrize(
    ("hz", "amplitude", "family"),
    [
        ((100.0, 100.0, 100.0), (0, 1, 0), "single tone"),
        ((100.0, 200.0, 300.0), (0, 1, 0), "single tone"),
        ((100.0, 100.0, 200.0), (1, 0.1, 0), "coherent"),
        ((100.0, 100.0, 200.0), (1, 0.1, 1), "two tones"),
        ((100.0, 150.0, 200.0), (1, 0.1, 1), "several tones"),
    ],
)
def test_a_family_goes_by_the_tones_that_sound(
    hz: tuple[float, ...], amplitude: tuple[float, ...], family: str
) -> None:
    weights = judged(1, 3)[0].weights
    assert FoundDrive(np.array(hz), np.array(amplitude, dtype=np.complex128), 1.0, 1.0, weights).family == family
