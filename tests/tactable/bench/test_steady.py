"""The benchmark of steady drives: it solves what it says, and its known optima are reached."""

import json
from dataclasses import replace

from tactable.bench.steady import run_steady_bench
from tests.precompute.devices import shipped, with_zones


def test_every_number_of_fingers_is_timed_and_every_entry_compared() -> None:
    device = replace(with_zones(shipped("reference-a"), 2), levels_db=(20.0,))
    result = run_steady_bench(device, states=5, placements=2, seed=1)
    assert json.loads(json.dumps(result)) == result
    assert set(result["solve_ms"]) == {"1", "2", "3", "5", "10"}
    assert all(0 < each["median"] <= each["p95"] for each in result["solve_ms"].values())
    compared = result["tabulated"]
    assert compared["entries"] == 10  # 3^2 - 2^2 states at one level and full scale
    assert compared["ratio"] > 1
    known = compared["difference_db"]["known_optimum_of_one_tone"]
    assert known["entries"] > 0 and known["worst"] >= -0.05
