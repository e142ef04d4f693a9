"""Minutes of the day that `replay_day` plays: memory stays, no lease runs out, nothing is collected."""

import pytest

from engine.touch.sources.recording import read_recording
from tactable.shipped import DEMO_RECORDING
from tests.studies.cost.replay_day import replay


def test_no_lease_runs_out_and_nothing_is_collected() -> None:
    day = replay([read_recording(DEMO_RECORDING)], 40.0, pieces=2)
    assert day.reports > 3_000
    assert day.commands > 50
    assert day.renewals > 250
    assert day.expired_leases == 0
    assert day.counters is not None
    assert (day.counters.stale, day.counters.refused) == (0, 0)
    assert day.collections == 0
    assert day.unreachable == 0  # no cycles: nothing waits for a collector that never comes


@pytest.mark.long
def test_memory_stays() -> None:
    day = replay([read_recording(DEMO_RECORDING)], 160.0, pieces=8)
    # By the sixth piece as many drives are remembered as ever will be.
    assert day.memory_mib[-1] == pytest.approx(day.memory_mib[5], abs=2.0)
