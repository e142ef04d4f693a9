"""Placements, cheap options and fresh plants with which the laws of clicks are checked."""

from functools import cache

from engine.device import Device
from engine.touch import Placement, ZoneState
from precompute.clicks.basis import lines_for
from precompute.clicks.options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.plants import SampledPlants
from precompute.clicks.responses import Responses
from precompute.clicks.solver import ClickSolver
from precompute.sampling.plants import sample_scenarios
from tests.precompute.devices import shipped

CHEAP = ClickOptions(pool=90, judged=20)
"""Few plants: enough for laws, not for figures."""
FRESH_SEED = 977

_KINDS = {"-": ZoneState.FREE, "q": ZoneState.QUIET, "F": ZoneState.FELT}


def placed(device: Device, letters: str) -> Placement:
    """Fingers in the middles of the zones, one letter a zone: F felt, q quiet, - free."""
    return Placement.in_zones(device, tuple(_KINDS[letter] for letter in letters))


@cache
def solver_of(name: str, options: ClickOptions = CHEAP) -> ClickSolver:
    """The solver of a shipped device."""
    return ClickSolver(shipped(name), options)


@cache
def _fresh_plants(name: str, count: int) -> SampledPlants:
    device = shipped(name)
    return SampledPlants(sample_scenarios(device, count, FRESH_SEED), lines_for(device, DEFAULT_OPTIONS.length_s))


def fresh_responses(name: str, placement: Placement, count: int = 2000, tolerance_m: float | None = None) -> Responses:
    """Responses of sampled plants of a shipped device that no click was made with, under clicks of the usual length."""
    plants = _fresh_plants(name, count)
    return Responses(plants.transfer(plants.scenarios.place(placement.position_m, tolerance_m)), plants.lines)
