"""Minutes of the day that `replay_day` plays: memory stays, no lease runs out, nothing is collected."""

import pytest

from engine.touch.sources.recording import read_recording
from tactable.shipped import DEMO_RECORDING
from tests.studies.cost.replay_day import replay


def test_memory_stays_no_lease_runs_out_and_nothing_is_collected() -> None:
    day = replay([read_recording(DEMO_RECORDING)], 160.0, pieces=8)
    assert day.reports > 12_000
    assert day.commands > 200
    assert day.renewals > 1_000
    assert day.expired_leases == 0
    assert day.counters is not None
    assert (day.counters.stale, day.counters.refused) == (0, 0)
    assert day.collections == 0
    assert day.unreachable == 0  # no cycles: nothing waits for a collector that never comes
    # By the sixth piece as many drives are remembered as ever will be.
    assert day.memory_mib[-1] == pytest.approx(day.memory_mib[5], abs=2.0)
