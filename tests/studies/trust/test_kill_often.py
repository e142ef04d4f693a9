"""Whatever instant it is killed at: nothing half is accepted, a run never lacks a table, and started again it ends."""

from pathlib import Path

import pytest

from tests.studies.trust.kill_often import kill_often, work_of

TIMES = {"swap": 2, "calibrate": 2, "fleet": 1}
"""`python -m tests.studies.trust.kill_often WHAT 200` is the long version, and has the build, too."""


# `calibrate --apply` builds a table and its clicks by several processes. Others of the same law: test_build_clicks goes
# on with a build, test_new_folder is killed.
@pytest.mark.machine
@pytest.mark.parametrize("what", TIMES)
def test_killed_at_any_instant_it_leaves_what_is_whole_and_goes_on(what: str, tmp_path: Path) -> None:
    with work_of(what, tmp_path) as work:
        reached, _ = kill_often(work, tmp_path, TIMES[what], seed=len(what))
    assert sum(reached.values()) == TIMES[what]
