"""Whatever instant it is killed at: nothing half is accepted, a run never lacks a table, and started again it ends."""

import os
from pathlib import Path

import pytest

from tests.studies.trust.kill_often import kill_often, work_of

KILLS = int(os.environ.get("TACTABLE_KILLS", "0"))
WORKS = ("swap", "build", "calibrate", "fleet", "fleet-processes")


def kill(what: str, times: int, folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    with work_of(what, folder) as work:
        reached, _ = kill_often(work, folder, times, seed=len(what))
    assert sum(reached.values()) == times


@pytest.mark.machine(stall_s=None)
def test_killed_at_any_instant_a_swap_leaves_whole_tables_and_the_run_goes_on(tmp_path: Path) -> None:
    kill("swap", 2, tmp_path)


@pytest.mark.machine
@pytest.mark.skipif(not KILLS, reason="long run: set TACTABLE_KILLS, such as 200 (an hour)")
def test_killed_often_all_work_leaves_what_is_whole_and_goes_on(tmp_path: Path) -> None:
    for what in WORKS:
        kill(what, KILLS, tmp_path / what)
