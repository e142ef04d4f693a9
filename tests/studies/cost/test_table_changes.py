"""Changes of table beside a run are seen where they happen, and cost it no report."""

from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from tactable.bench.latency.background_load import BackgroundLoad
from tests.studies.cost.table_changes import FRAME_NS, Segment, measure_changes
from tests.tactable.run.test_table_watch import DEVICE, write


def tables_of(folder: Path, device: Device = DEVICE) -> tuple[Path, Path]:
    paths = folder / "one.nc", folder / "other.nc"
    for path, response in zip(paths, (1.0, 2.0), strict=True):
        write(path, response, device)
    return paths


@pytest.mark.machine
def test_every_change_is_seen_and_no_report_is_lost(tmp_path: Path) -> None:
    found = measure_changes(tables_of(tmp_path), 2, BackgroundLoad.IDLE, tmp_path)
    assert found["with"]["changes"] == found["with"]["changes_counted_by_the_run"] == 2
    assert found["without"]["changes"] == found["without"]["changes_counted_by_the_run"] == 0
    assert found["with"]["reports_lost"] == found["without"]["reports_lost"] == 0
    assert found["with"]["commands"] > 0


def test_a_pause_is_how_late_the_latest_report_about_it_was() -> None:
    late_ns = np.array([0, 0, 7, 3, 0, 0], np.int64) * FRAME_NS
    due_ns = np.arange(6, dtype=np.int64) * 100 * FRAME_NS
    nothing = np.zeros(0, np.int64)
    segment = Segment({}, 0, late_ns, due_ns, nothing, nothing)
    assert segment.pauses_ns(np.array([200, 290, 350]) * FRAME_NS).tolist() == [7 * FRAME_NS, 3 * FRAME_NS, 0]
