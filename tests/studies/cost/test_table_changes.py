"""The study of changes of table: what it takes for a pause."""

import numpy as np

from tests.studies.cost.table_changes import FRAME_NS, Segment


def test_a_pause_is_how_late_the_latest_report_about_it_was() -> None:
    late_ns = np.array([0, 0, 7, 3, 0, 0], np.int64) * FRAME_NS
    due_ns = np.arange(6, dtype=np.int64) * 100 * FRAME_NS
    nothing = np.zeros(0, np.int64)
    segment = Segment({}, 0, late_ns, due_ns, nothing, nothing)
    assert segment.pauses_ns(np.array([200, 290, 350]) * FRAME_NS).tolist() == [7 * FRAME_NS, 3 * FRAME_NS, 0]
