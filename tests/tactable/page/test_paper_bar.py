"""The bar that rows of the sweep move: as loud and as localized as finite elements say, and no longer than ours."""

import pytest

from engine.table import Table
from engine.table.best_rows import BestRows
from engine.touch import Placement
from firmware_link.protocol.messages import ChannelDrive
from tactable.page.live_bar import LiveBar
from tactable.page.messages import LOWEST_DB
from tactable.page.paper_bar import PaperBar
from tactable.page.ring_drive import RingDrive
from tactable.page.view import View
from tactable.rig.promises import Promises
from tests.engine.made_rows import row_of, rows_of
from tests.tactable.page.played import FRAME_US, RESOLUTION_HZ, record_of

PAIR = Placement((0.035, 0.22), (True, False))


def played(table: Table, seconds: float, *, is_click: bool, rows: BestRows | None = None) -> View:
    """A view of a command at 50 ms, so many seconds after it; the second bar plays rows, by default the table's."""
    paper = PaperBar(table.device, table.best_rows if rows is None else rows)
    view = View(table, LiveBar(table.device), RESOLUTION_HZ, paper=paper)
    view.move(50_000.0, is_loaded=True)
    record = record_of(table, PAIR, 50_001_000, is_click=is_click)
    view.take_events(RingDrive(table, RESOLUTION_HZ).events([record]))
    view.read([record])
    while view.bar.now_us < 50_000 + 1e6 * seconds:
        view.move(view.bar.now_us + FRAME_US, is_loaded=True)
    return view


def test_the_row_of_the_sweep_comes_to_what_finite_elements_say(table: Table) -> None:
    paper = played(table, 3.0, is_click=False).picture().paper
    row, promise = Promises(table).of_row(PAIR, 20.0)
    assert paper is not None and row.zones == (0,)
    assert list(paper.simulated_db) == pytest.approx(promise.level_db, abs=0.5)
    assert [present_db for present_db, _ in paper.fingers_db] == list(paper.simulated_db)


def test_a_row_of_two_frequencies_moves_the_bar_with_both(table: Table) -> None:
    view = played(table, 2.0, is_click=False, rows=rows_of(table.device))
    row = row_of(table.device, (0,))
    channels = [ChannelDrive(*each) for each in zip(row.frequencies_hz, row.amplitudes, row.phases_rad, strict=True)]
    paper = view.picture().paper
    assert paper is not None
    assert list(paper.simulated_db) == pytest.approx(Promises(table).of_channels(PAIR, channels).level_db, abs=0.5)


def test_ours_has_more_contrast_than_the_papers(table: Table) -> None:
    picture = played(table, 2.0, is_click=False).picture()
    assert picture.paper is not None
    ours, papers = [each.simulated_db for each in picture.made], picture.paper.simulated_db
    assert ours[0] is not None and ours[1] is not None and papers[0] is not None and papers[1] is not None
    assert ours[0] - ours[1] > papers[0] - papers[1] + 3


def test_beside_a_click_the_drive_ends_when_the_click_does(table: Table) -> None:
    view = played(table, 0.5, is_click=True)
    assert view.paper is not None
    bar = view.paper.levels.bar
    during, after = bar.motion(60_000.0, 0.02, 1), bar.motion(450_000.0, 0.02, 1)
    assert during is not None and after is not None
    assert abs(during).max() > 10 * abs(after).max() > 0


def test_zones_without_a_row_leave_the_second_bar_at_rest(table: Table) -> None:
    paper = played(table, 0.4, is_click=False, rows=BestRows([], 1.0)).picture().paper
    assert paper is not None and paper.levels_db.max() == LOWEST_DB


def test_a_stall_over_two_commands_plays_both(table: Table) -> None:
    """The second command is read before the bar has moved to the end of the first one."""
    steps = [played_twice(table, step_us) for step_us in (FRAME_US, 0.9e6)]
    assert steps[0] == pytest.approx(steps[1], abs=0.1)
    assert steps[0][0] > LOWEST_DB


def played_twice(table: Table, step_us: float) -> list[float]:
    view = View(table, LiveBar(table.device), RESOLUTION_HZ, paper=PaperBar(table.device, table.best_rows))
    view.move(50_000.0, is_loaded=True)
    records = [record_of(table, PAIR, at_ns, is_click=True) for at_ns in (50_001_000, 450_001_000)]
    view.take_events(RingDrive(table, RESOLUTION_HZ).events(records))
    view.read(records)
    while view.bar.now_us < 850_000:
        view.move(min(view.bar.now_us + step_us, 850_000.0), is_loaded=True)
    paper = view.picture().paper
    assert paper is not None
    return [felt_db for _, felt_db in paper.fingers_db]
