"""The greatest acceleration of each place: a bound on every drive, met by the best one."""

import numpy as np
import pytest

from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.studies.reach_along import compute_reach
from tests.precompute.devices import every_device

TENTH_DB = 10 ** (0.1 / 20)
"""What may lie between two frequencies (tests/precompute/model/test_frequencies.py)."""


@pytest.mark.parametrize("name", every_device())
def test_no_drive_gives_a_place_more(name: str) -> None:
    device = every_device()[name]
    plant, place_m = assemble(device), np.linspace(0.0, device.bar.length_m, 21)
    reach = compute_reach(plant, place_m)
    random = np.random.default_rng(5)
    for _ in range(40):
        hz = random.uniform(60.0, 300.0, len(device.actuators))
        amplitude = random.uniform(0.0, 1.0, len(hz))
        each = abs(solve_response(plant, hz).acceleration(place_m))[np.arange(len(hz)), np.arange(len(hz))]
        assert (amplitude @ each <= TENTH_DB * reach.tones).all()
        together = np.exp(2j * np.pi * random.random(len(hz))) @ solve_response(plant, hz[:1]).acceleration(place_m)[0]
        assert (abs(together) <= TENTH_DB * reach.one_tone).all()
