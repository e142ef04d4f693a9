"""Laws of comparing two measurements: the same is no change, worse is worse, and the machine's share is not ours."""

import numpy as np

from tactable.bench.latency.compare import (
    Rounds,
    compare_condition,
    compare_runs,
    got_worse,
)
from tactable.bench.latency.stages import Point
from tests.tactable.bench.latency.test_stages import WAYS_NS


def rounds_of(seed: int, scale: float = 1.0, **slower: float) -> Rounds:
    """Four rounds of 400 commands with some spread; every stage times `scale`, the named ones times their own."""
    random = np.random.default_rng(seed)
    ways = np.array([*WAYS_NS.values()]) * scale * random.lognormal(0.0, 0.2, (4, 400, len(WAYS_NS)))
    for name, factor in slower.items():
        ways[..., Point[name] - 1] *= factor
    stamps = np.full((4, 400, len(Point)), np.nan)
    stamps[..., 0] = 0.0
    stamps[..., 1 : Point.WRITTEN + 1] = ways.cumsum(axis=2)
    return list(stamps)


def test_the_same_is_no_change_and_what_got_worse_is_said_with_its_stage_and_what_got_better_too() -> None:
    found = compare_condition(rounds_of(1), rounds_of(2), 1.0)
    for name in ("median", "p99"):
        assert found[name]["verdict"] == "no difference that these samples tell"
        assert found[name]["low"] < 1 < found[name]["high"]
    found = compare_condition(rounds_of(1, WRITTEN=3.0), rounds_of(2), 1.0)
    assert found["median"]["verdict"] == "worse"
    assert found["median"]["low"] <= (67 + 18) / 67 <= found["median"]["high"]
    assert (found["stage"]["name"], found["stage"]["layer"]) == ("encode and write", "link")
    assert found["stage"]["low_us"] <= 18 <= found["stage"]["high_us"]
    assert compare_condition(rounds_of(1), rounds_of(2, READ=3.0), 1.0)["median"]["verdict"] == "better"


def test_a_slower_machine_is_not_a_worse_engine() -> None:
    ours, floor = "tactable", "C echo"
    before = {ours: rounds_of(1), floor: rounds_of(2)}
    slower = {ours: rounds_of(3, 1.4), floor: rounds_of(4, 1.4)}
    assert got_worse(compare_runs(slower, before, {ours: floor})) == []
    assert got_worse(compare_runs({**slower, floor: rounds_of(4)}, before, {ours: floor})) == [ours]
    assert got_worse(compare_runs(slower, before, {})) == [ours, floor]
    assert compare_runs({"a": rounds_of(1)}, {"b": rounds_of(1)}, {}) == {}, "conditions of one run only"
