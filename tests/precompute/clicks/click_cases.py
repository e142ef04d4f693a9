"""Placements, cheap options and fresh plants with which the laws of clicks are checked."""

from functools import cache

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATIONS_PER_SAMPLE, Tones, lines_for
from precompute.clicks.click_options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_plants import SampledPlants
from precompute.clicks.click_responses import Responses
from precompute.clicks.click_solver import ClickSolver
from precompute.sampling.plants import sample_scenarios
from tests.precompute.devices import shipped

CHEAP = ClickOptions(pool=90, judged=20)
"""Few plants: enough for laws, not for figures."""
FRESH_SEED = 977


def placed(device: Device, letters: str) -> Placement:
    """Fingers in the middles of the zones, one letter a zone: F felt, q quiet, - free."""
    felt, quiet = ([zone.name for zone, role in zip(device.zones, letters, strict=True) if role == k] for k in "Fq")
    return Placement.named(device, felt, quiet)


@cache
def solver_of(name: str, options: ClickOptions = CHEAP) -> ClickSolver:
    return ClickSolver(shipped(name), options)


@cache
def _fresh_plants(name: str, count: int) -> SampledPlants:
    device = shipped(name)
    return SampledPlants(sample_scenarios(device, count, FRESH_SEED), lines_for(device, DEFAULT_OPTIONS.length_s))


def fresh_responses(name: str, placement: Placement, count: int = 2000, tolerance_m: float | None = None) -> Responses:
    """Responses of sampled plants of a shipped device that no click was made with, under clicks of the usual length."""
    plants = _fresh_plants(name, count)
    return Responses(plants.transfer(plants.scenarios.place(placement.position_m, tolerance_m)), plants.lines)


def mean_plant(responses: Responses) -> Responses:
    """The mean over the scenarios, as one scenario."""
    return Responses(responses.transfer.mean(axis=0, keepdims=True), responses.lines)


def play_each(responses: Responses, tones: Tones) -> Array:
    """Weighted acceleration (scenario, finger, time, tone) of each tone alone, at EVALUATION_RATE_HZ."""
    lines = responses.transfer[:, :, tones.actuator] * responses.lines.transform(tones.wave)
    courses = responses.lines.course(lines, EVALUATIONS_PER_SAMPLE)
    return np.asarray(courses.swapaxes(2, 3), dtype=np.float64)
