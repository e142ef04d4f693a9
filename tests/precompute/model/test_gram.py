"""Law of the zone Gram matrices: they sum to that of the bar. tests/precompute/sweep/test_grid.py has their values."""

import itertools
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Zone
from precompute.model.assembly import assemble
from precompute.model.gram import compute_gram
from precompute.model.response import solve_response
from tests.precompute.devices import shipped

FREQUENCY_HZ = np.array([20.0, 60.0, 112.0, 140.0, 179.35, 208.57, 230.0, 300.0])


@given(st.lists(st.floats(0.001, 0.999), min_size=1, max_size=7, unique_by=lambda x: round(x, 4)))
def test_cutting_zones_anywhere_neither_makes_nor_loses_energy(cuts: list[float]) -> None:
    device = shipped("reference-a")
    edges = [0.0, *(cut * device.bar.length_m for cut in sorted(cuts)), device.bar.length_m]
    zones = tuple(Zone(str(i), *pair) for i, pair in enumerate(itertools.pairwise(edges)))
    gram, total = compute_gram(solve_response(assemble(replace(device, zones=zones)), FREQUENCY_HZ))
    assert np.abs(gram.sum(axis=1) - total).max() <= 1e-12 * np.abs(total).max()
