"""The bar that the paper's drives move: as loud and as localized as finite elements say, and no longer than ours."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from engine.table import Table
from engine.touch import Placement
from precompute.entries.untouched import find_untouched_optima
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from tactable.page.live_bar import LiveBar
from tactable.page.messages import LOWEST_DB
from tactable.page.paper_bar import PaperBar, PaperDrives
from tactable.page.ring_drive import RingDrive
from tactable.page.view import View
from tests.tactable.page.played import FRAME_US, RESOLUTION_HZ, record_of

PAIR = Placement((0.035, 0.22), (True, False))


@pytest.fixture(scope="module")
def table(click_table: Path) -> Iterator[Table]:
    with Table.open(click_table) as opened:
        yield opened


def played(table: Table, seconds: float, *, is_click: bool, step_us: float = FRAME_US) -> View:
    """A view of a command at 50 ms, so many seconds after it."""
    view = View(table, LiveBar(table.device), RESOLUTION_HZ, paper=PaperBar(table.device))
    view.move(50_000.0, is_loaded=True)
    record = record_of(table, PAIR, 50_001_000, is_click=is_click)
    view.take(RingDrive(table, RESOLUTION_HZ).events([record]))
    view.read([record])
    while view.bar.now_us < 50_000 + 1e6 * seconds:
        view.move(view.bar.now_us + step_us, is_loaded=True)
    return view


def exact_levels_db(table: Table, level_db: float) -> list[float]:
    """Levels of the published optimum for the felt finger's zone, by finite elements with the fingers on the bar."""
    plant = assemble(table.device)
    _, drive = find_untouched_optima(plant, [0])
    hz = drive.frequency_hz[:1]
    loaded = plant.with_fingers(PAIR.position_m, table.device.finger)
    full = abs(drive.amplitude @ solve_response(loaded, hz).acceleration(np.array(PAIR.position_m))[0])
    full_db: list[float] = (20 * np.log10(full / table.device.threshold.peak_m_per_s2(hz))).tolist()
    quieter_db = min(level_db - full_db[0], 20 * math.log10(table.device.limits.amplitude))
    return [each + quieter_db for each in full_db]


def test_a_steady_drive_of_the_paper_comes_to_what_finite_elements_say(table: Table) -> None:
    paper = played(table, 3.0, is_click=False).picture().paper
    assert paper is not None
    assert list(paper.simulated_db) == pytest.approx(exact_levels_db(table, 20.0), abs=0.5)
    assert [present_db for present_db, _ in paper.fingers_db] == list(paper.simulated_db)


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


def test_a_finger_outside_all_zones_leaves_the_paper_without_a_drive(table: Table) -> None:
    device = table.device
    drives = PaperDrives(device)
    assert drives.drive_for(PAIR, 20.0) is not None
    zone = device.zones[0]
    nobody = Placement(((zone.start_m + zone.stop_m) / 2,), (False,))
    assert drives.drive_for(nobody, 20.0) is None


def test_the_drive_is_as_loud_as_wanted_within_full_scale(table: Table) -> None:
    drives = PaperDrives(table.device)
    quiet, loud, full = (drives.drive_for(PAIR, level_db) for level_db in (-20.0, -10.0, math.inf))
    assert quiet is not None and loud is not None and full is not None
    assert abs(loud[1]).max() == pytest.approx(abs(quiet[1]).max() * 10**0.5)
    assert abs(full[1]).max() == pytest.approx(table.device.limits.amplitude)


def test_a_stall_over_two_commands_plays_both(table: Table) -> None:
    """The second command is read before the bar has moved to the end of the first one."""
    steps = [played_twice(table, step_us) for step_us in (FRAME_US, 0.9e6)]
    assert steps[0] == pytest.approx(steps[1], abs=0.1)
    assert steps[0][0] > LOWEST_DB


def played_twice(table: Table, step_us: float) -> list[float]:
    view = View(table, LiveBar(table.device), RESOLUTION_HZ, paper=PaperBar(table.device))
    view.move(50_000.0, is_loaded=True)
    records = [record_of(table, PAIR, at_ns, is_click=True) for at_ns in (50_001_000, 450_001_000)]
    view.take(RingDrive(table, RESOLUTION_HZ).events(records))
    view.read(records)
    while view.bar.now_us < 850_000:
        view.move(min(view.bar.now_us + step_us, 850_000.0), is_loaded=True)
    paper = view.picture().paper
    assert paper is not None
    return [felt_db for _, felt_db in paper.fingers_db]
