"""The bar that rows of the sweep move: as loud and as localized as finite elements say, and no longer than ours."""

import pytest

from engine.table import Table
from engine.table.best_rows import BestRows
from firmware_link.protocol.messages import ChannelDrive
from tactable.page.live_bar import LiveBar
from tactable.page.page_messages import LOWEST_DB
from tactable.page.paper_bar import PaperBar
from tactable.page.view import View
from tactable.rig.promises import Promises
from tests.engine.made_rows import row_of, rows_of
from tests.tactable.page.test_view import PAIR, Rig


def played(table: Table, seconds: float, *, is_click: bool, rows: BestRows | None = None) -> View:
    """A view of a command at 50 ms, so many seconds after it; the second bar plays rows, by default the table's."""
    rig = Rig(table, PaperBar(LiveBar(table.device), table.best_rows if rows is None else rows))
    rig.go_on(0.05)
    rig.play(seconds, is_click=is_click)
    return rig.view


def test_the_row_of_the_sweep_comes_to_what_finite_elements_say_with_less_contrast_than_ours(table: Table) -> None:
    picture = played(table, 3.0, is_click=False).picture()
    row, promise = Promises(table).of_row(PAIR, 20.0)
    assert picture.paper is not None and row.zones == (0,)
    assert list(picture.paper.simulated_db) == pytest.approx(promise.level_db, abs=0.5)
    assert [present_db for present_db, _ in picture.paper.fingers_db] == list(picture.paper.simulated_db)
    ours_db = [each.simulated_db or LOWEST_DB for each in picture.made]
    assert ours_db[0] - ours_db[1] > promise.level_db[0] - promise.level_db[1] + 3.5


def test_a_row_of_two_frequencies_moves_the_bar_with_both(table: Table) -> None:
    view = played(table, 2.0, is_click=False, rows=rows_of(table.device))
    row = row_of(table.device, (0,))
    channels = [ChannelDrive(*each) for each in zip(row.frequencies_hz, row.amplitudes, row.phases_rad, strict=True)]
    paper = view.picture().paper
    assert paper is not None
    assert list(paper.simulated_db) == pytest.approx(Promises(table).of_channels(PAIR, channels), abs=0.5)


def test_beside_a_click_the_drive_ends_when_the_click_does(table: Table) -> None:
    view = played(table, 0.5, is_click=True)
    assert view.paper is not None
    bar = view.paper.levels.bar
    during, after = bar.motion(60_000.0, 0.02, 1, ()), bar.motion(450_000.0, 0.02, 1, ())
    assert during is not None and after is not None
    assert abs(during).max() > 10 * abs(after).max() > 0


def test_zones_without_a_row_leave_the_second_bar_at_rest(table: Table) -> None:
    paper = played(table, 0.4, is_click=False, rows=BestRows([], 1.0)).picture().paper
    assert paper is not None and paper.levels_db.max() == LOWEST_DB
