"""The rivals of the benchmark compute what the sweep computes: a race between different things shows nothing."""

import numpy as np

from precompute.model.assembly import assemble_bar
from precompute.sweep.grid import compute_grid_response, zone_points
from precompute.sweep.tabulate import prepare_pair_sweep
from tactable.bench.sweep import numpy_twin, solve_point
from tactable.shipped import find_device

DEVICE = find_device("reference-a")
PLANT = assemble_bar(DEVICE)
GRID = compute_grid_response(PLANT, np.linspace(60.0, 300.0, 9), zone_points(DEVICE))


def test_the_numpy_twin_and_a_solved_point_are_the_table_s() -> None:
    sweep = prepare_pair_sweep(GRID, (0, 1))
    ours, twin = ([np.zeros((9, 36, 5, 9), dtype=np.float32) for _ in range(3)] for _ in range(2))
    sweep.fill(slice(None), ours)
    numpy_twin(sweep, slice(0, 9), twin)
    np.testing.assert_allclose(ours, twin, rtol=2e-5)
    found = solve_point(PLANT, GRID.position_m, GRID.frequency_hz[[2, 7]], np.array([0.6, 0.8]))
    np.testing.assert_allclose([values[2, 3 * 6 + 4, :, 7] for values in ours[:2]], found, rtol=1e-5)
