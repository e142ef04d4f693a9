"""Laws of the sweep kernels: equal to plain numpy twins, ratios fold without loss, homogeneous in the amplitudes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from base.arrays import Complex, Single
from precompute.sweep.sweep_kernels import fill_coherent_sweep, fill_pair_sweep, fold_amplitudes

few = settings(max_examples=settings().max_examples // 3)
seeds = st.integers(0, 2**32 - 1)
small = st.integers(1, 4)
eights = st.integers(1, 3).map(lambda count: 8 * count)


def positive(random: np.random.Generator, *shape: int) -> Single:
    """Three decades, never 0."""
    return (10 ** random.uniform(-2, 1, shape)).astype(np.float32)


def pair_sweep(random: np.random.Generator, shape: tuple[int, int, int, int], steps: int) -> tuple[Single, ...]:
    """Inputs and outputs of fill_pair_sweep for every amplitude pair: level_1, level_2, energies, totals, figures."""
    count_1, count_2, zones, points = shape
    level_1, level_2 = positive(random, count_1, zones, points), positive(random, zones, points, count_2)
    energy_1, energy_2 = positive(random, count_1, zones), positive(random, zones, count_2)
    total_1, total_2 = energy_1.sum(axis=1) * 1.5, energy_2.sum(axis=0) * 1.5
    fold = fold_amplitudes(steps)
    outs = [np.empty((count_1, (steps + 1) ** 2, zones, count_2), dtype=np.float32) for _ in range(3)]
    scale = fold.multiple.ravel().astype(np.float32)
    inputs = (level_1, level_2, energy_1, energy_2, total_1, total_2)
    fill_pair_sweep(*inputs, fold.first, fold.second, fold.ratio.ravel(), scale, *outs)
    return (*inputs, *outs)


@few
@given(seeds, st.tuples(small, small, small, eights), st.integers(1, 4))
def test_pair_sweep_equals_numpy(seed: int, shape: tuple[int, int, int, int], steps: int) -> None:
    results = pair_sweep(np.random.default_rng(seed), shape, steps)
    level_1, level_2, energy_1, energy_2, total_1, total_2, factor, peak, dead = results
    for k in range(1, (steps + 1) ** 2):
        u, v = k // (steps + 1) / steps, k % (steps + 1) / steps
        level = u * level_1[..., None] + v * level_2  # paper eq. (8), (frequency_1, zone, point, frequency_2)
        assert peak[:, k] == pytest.approx(level.max(axis=2), rel=1e-5)
        assert dead[:, k] == pytest.approx(level.min(axis=2), rel=1e-5)
        energy = u**2 * energy_1[..., None] + v**2 * energy_2  # paper eq. (10)
        total = u**2 * total_1[:, None, None] + v**2 * total_2
        assert factor[:, k] == pytest.approx(energy / total, rel=1e-5)


@few
@given(st.integers(1, 40))
def test_folding_reproduces_every_amplitude_pair_and_keeps_each_ratio_once(steps: int) -> None:
    fold = fold_amplitudes(steps)
    grid = np.arange(steps + 1) / steps
    assert fold.multiple * fold.first[fold.ratio] == pytest.approx(np.broadcast_to(grid[:, None], fold.ratio.shape))
    assert fold.multiple * fold.second[fold.ratio] == pytest.approx(np.broadcast_to(grid, fold.ratio.shape))
    angles = np.arctan2(fold.second.astype(float), fold.first.astype(float))
    assert np.diff(np.sort(angles)).min() > 1e-6
    assert set(fold.ratio[fold.multiple > 0]) == set(range(len(angles)))
    assert np.argwhere(fold.multiple == 0).tolist() == [[0, 0]]


def coherent_inputs(random: np.random.Generator, shape: tuple[int, int, int, int, int]) -> tuple[Complex, ...]:
    """acceleration, gram, total, drive: Grams of random velocities, a fifth zone's worth outside all zones."""
    count, actuators, zones, points, directions = shape

    def normal(*sizes: int) -> Complex:
        parts = random.normal(size=(2, *sizes))
        out: Complex = parts[0] + 1j * parts[1]
        return out

    velocity = normal(count, zones + 1, 6, actuators)
    gram = np.einsum("fzpa,fzpb->fzab", velocity.conj(), velocity)
    return normal(count, actuators, zones, points), gram[:, :zones], gram.sum(axis=1), normal(actuators, directions)


def split(values: Complex) -> tuple[Single, Single]:
    return np.ascontiguousarray(values.real, np.float32), np.ascontiguousarray(values.imag, np.float32)


@few
@given(seeds, st.tuples(small, small, small, st.integers(1, 17), st.integers(1, 20)))
def test_coherent_sweep_equals_numpy(seed: int, shape: tuple[int, int, int, int, int]) -> None:
    acceleration, gram, total, drive = coherent_inputs(np.random.default_rng(seed), shape)
    factor, peak, dead = (np.empty((shape[0], shape[2], shape[4]), dtype=np.float32) for _ in range(3))
    fill_coherent_sweep(*split(acceleration), *split(gram), *split(total), *split(drive), factor, peak, dead)
    level = abs(np.einsum("fazp,ad->fzpd", acceleration, drive))
    energy = np.einsum("ad,fzab,bd->fzd", drive.conj(), gram, drive).real
    whole = np.einsum("ad,fab,bd->fd", drive.conj(), total, drive).real
    assert factor == pytest.approx(energy / whole[:, None], rel=1e-3, abs=1e-5)
    assert peak == pytest.approx(level.max(axis=2), rel=1e-4)
    assert dead == pytest.approx(level.min(axis=2), rel=1e-3, abs=1e-5)
