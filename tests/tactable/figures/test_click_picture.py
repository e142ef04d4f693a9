"""Laws of the picture of a click: its data are the click's, and its words the table's figures."""

from math import inf

import numpy as np
import pytest

from tactable.explain.click_source import ClickSource
from tactable.figures.click_picture import plot_click
from tactable.figures.picture_file import Picture
from tests.tactable.click_table import click_of, placed


def picture_of(source: ClickSource, felt: str, quiet: str, level_db: float = inf) -> Picture:
    return plot_click(source, click_of(source, felt, quiet, level_db), placed(source, felt, quiet))


def test_the_data_have_the_level_of_the_table_and_one_that_is_not_reached_is_said(source: ClickSource) -> None:
    missed = picture_of(source, "I", "III", 60.0)
    assert "NOT ACHIEVED (60 dB wanted)" in missed.caption
    assert missed.summary["achieved"] is False
    columns = picture_of(source, "I", "III", 1.0).columns
    click = source.table.click_for(["I"], ["III"], 1.0)
    assert click.quiet is not None
    for header, spread in (("46.57 mm (I) felt", click.felt), ("232.8 mm (III) quiet", click.quiet)):
        nominal = np.asarray(columns[f"{header}, nominal (acceleration over threshold)"])
        assert 20 * np.log10(abs(nominal).max()) == pytest.approx(spread.nominal_db, abs=1e-3)
    picture = picture_of(source, "I", "III")
    assert picture.summary["level_db"] == source.table.click_for(["I"], ["III"], inf).level_db
    felt, _ = picture.summary["fingers"]
    assert felt["peak_db"]["5 %"] == pytest.approx(picture.summary["level_db"], abs=1e-3)
    peak = abs(click.samples[:, 0]).max() / 32767
    left = np.asarray(columns["left (fraction of full scale)"])
    assert abs(left).max() == pytest.approx(peak * click.amplitude)
