"""Laws of the map of clicks: every state of two fingers is in it, with the figures of the table."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product

import pytest

from engine.table import TableError
from engine.touch import Placement
from precompute.clicks.baselines import GATED_DRIVE
from tactable.explain.click_source import ClickSource
from tactable.figures.click_map import plot_click_map
from tactable.figures.file import Picture

NAMES = ("I", "II", "III")


@pytest.fixture(scope="module")
def progress() -> list[float]:
    return []


@pytest.fixture(scope="module")
def picture(source: ClickSource, progress: list[float]) -> Iterator[Picture]:
    yield plot_click_map(source, progress.append)


def test_every_ordered_pair_is_there_with_the_figures_of_the_table(source: ClickSource, picture: Picture) -> None:
    columns = picture.columns
    pairs = list(zip(columns["felt zone"], columns["quiet zone"], strict=True))
    assert pairs == [(felt, "" if felt == quiet else quiet) for felt, quiet in product(NAMES, repeat=2)]
    for row, (felt, quiet) in enumerate(pairs):
        click = source.table.click_for([felt], [quiet] if quiet else [], float("inf"))
        assert columns["felt level of the click, 5 % (dB above threshold oh-choi-2019)"][row] == click.felt.low_db
        quiet_db = columns["quiet level of the click, 95 % (dB above threshold oh-choi-2019)"][row]
        assert quiet_db == (None if click.quiet is None else click.quiet.high_db)


def test_beside_it_is_the_gated_drive_judged_alike(source: ClickSource, picture: Picture) -> None:
    gated = source.solve_baseline(Placement.named(source.table.device, ["III"], ["I"]), GATED_DRIVE, 0.02).evaluation
    assert gated.quiet is not None
    assert picture.summary["gated_felt_level_db"][2][0] == pytest.approx(gated.felt.low_db)
    assert picture.summary["gated_quiet_level_db"][2][0] == pytest.approx(gated.quiet.high_db)


def test_the_fraction_done_rises_to_one(picture: Picture, progress: list[float]) -> None:
    assert picture.caption
    assert len(progress) == 9 and progress[-1] == 1 and all(one < other for one, other in pairwise(progress))


def test_a_bar_of_one_zone_is_refused(source: ClickSource, monkeypatch: pytest.MonkeyPatch) -> None:
    device = source.table.device
    monkeypatch.setattr(source.table, "device", replace(device, zones=device.zones[:1]))
    with pytest.raises(TableError, match="two zones"):
        plot_click_map(source, list[float]().append)
