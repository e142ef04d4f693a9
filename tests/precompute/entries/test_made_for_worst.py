"""Laws of entries for the worst 5 %: their promise holds in 95 % of the sampled cases, better than the mean's do."""

from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.table import Entry, Table
from precompute.builder.build import build_table
from precompute.entries.prediction import MadeFor
from precompute.entries.solver import EntrySolver, tabulated_states
from precompute.model.assembly import assemble
from tests.precompute.sampling.test_bars import calibrated

pytestmark = pytest.mark.long

DEVICE = calibrated(0.03, spread=0.01)
STATES = tabulated_states(DEVICE)
MEAN, WORST = (EntrySolver(assemble(DEVICE), made_for=made_for) for made_for in MadeFor)


@pytest.fixture(scope="module")
def both() -> list[tuple[Entry, Entry]]:
    """The entries of the mean and of the worst, state by state and level by level."""
    return [pair for state in STATES for pair in zip(MEAN.solve(state), WORST.solve(state), strict=True)]


def low(entry: Entry) -> float:
    assert entry.spread is not None
    return entry.spread.felt.low_db


def test_a_level_that_is_reached_is_reached_in_95_percent_of_the_cases(both: list[tuple[Entry, Entry]]) -> None:
    reached = [worst for _, worst in both if worst.achieved and np.isfinite(worst.wanted_level_db)]
    assert reached
    for entry in reached:
        assert low(entry) == pytest.approx(entry.wanted_level_db, abs=1e-6)
        assert entry.reached_db == pytest.approx(low(entry), abs=1e-9)


def test_where_a_level_is_not_reached_nothing_found_is_louder(both: list[tuple[Entry, Entry]]) -> None:
    short = [(mean, worst) for mean, worst in both if not worst.achieved]
    assert short
    assert all(low(worst) >= low(mean) - 1e-6 for mean, worst in short)


def test_contrast_in_the_worst_cases_is_no_less_than_that_of_the_mean_where_both_are_loud_enough(
    both: list[tuple[Entry, Entry]],
) -> None:
    """What the mean finds is among what is chosen from, if it is loud enough for 95 %."""
    compared = 0
    for mean, worst in both:
        room_db = 20 * np.log10(DEVICE.limits.amplitude / max(mean.amplitudes))
        if np.isinf(mean.wanted_level_db) or low(mean) + room_db < mean.wanted_level_db or not worst.achieved:
            continue
        assert mean.spread is not None and worst.spread is not None
        if mean.spread.contrast is not None and worst.spread.contrast is not None:
            assert worst.spread.contrast.low_db >= mean.spread.contrast.low_db - 1e-6
            compared += 1
    assert compared


def test_it_claims_no_bound(both: list[tuple[Entry, Entry]]) -> None:
    assert all(np.isinf(worst.optimality_gap_db) for _, worst in both)


def test_a_table_says_what_it_is_made_for_and_plays_levels_between_accordingly(tmp_path: Path) -> None:
    device = Device.parse(DEVICE.text, "bar")
    build_table(device, tmp_path / "bar.nc", made_for=MadeFor.WORST, clicks_up_to=0)
    with Table.open(tmp_path / "bar.nc") as table:
        assert table.attributes["made_for"] == "worst"
        entry = next(each for each in table.entries_at(14.0) if each.achieved)
        assert low(entry) == pytest.approx(14.0, abs=1e-6)
        assert entry.level_db > 15.0  # the standard finger gets more than the worst ones
