"""Drives and clicks of a table in a notebook: what they hold, say and draw."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from engine.table import TableError
from tactable import Table


@pytest.fixture(scope="module")
def table(click_table: Path) -> Iterator[Table]:
    with Table.open(click_table) as table:
        yield table


def test_a_drive_holds_what_the_solver_found_and_who_asked(table: Table) -> None:
    drive = table.drive_for(felt=["35 mm"], quiet=["0.2 m"], level_db=15)
    found = drive.to_xarray()
    assert drive.asked.position_m == (0.035, 0.2) == tuple(found.position.values)
    assert found.amplitude.values == pytest.approx(drive.amplitudes)
    assert found.level.values == pytest.approx(drive.level_db)
    assert float(found.sampled_level.mean("case")[0]) == pytest.approx(drive.sampled_level_db[:, 0].mean())
    assert found.frequency.attrs["units"] == "Hz" and found.attrs["wanted_level_db"] == 15
    assert "detection threshold" in found.attrs["threshold"]
    assert repr(drive).startswith("<Drive 35 mm (I) felt, 200 mm (III) quiet: left ")
    assert f"expected contrast</td><td>{drive.expected_contrast_db:.1f} dB" in drive._repr_html_()


def test_a_click_is_the_waveform_as_played_with_its_promise(table: Table) -> None:
    click = table.click_for(["35 mm"], ["120 mm"], level_db=-5)
    found = click.to_xarray()
    played = click.samples / 32767 * click.amplitude
    assert found.waveform.values == pytest.approx(played, abs=1e-9)
    assert float(found.time[-1]) == pytest.approx(click.length_s)
    assert click.quiet is not None
    assert float(found.felt_level.sel(spread="5 %")) == click.felt.low_db
    assert float(found.quiet_level.sel(spread="95 %")) == click.quiet.high_db
    assert tuple(found.place.values) == click.placement.position_m != click.asked.position_m == (0.035, 0.12)
    assert np.isnan(table.click_for(["35 mm"]).to_xarray().quiet_level).all()
    assert "<Click 35 mm (I) felt, 120 mm (II) quiet: length 30 ms; made for" in repr(click)


def test_pictures_are_those_of_the_command(table: Table) -> None:
    drive, click = table.drive_for(["35 mm"], ["0.2 m"]), table.click_for(["35 mm"], ["0.2 m"])
    for figure in (drive.plot(), click.plot()):
        assert all(axes.has_data() for axes in figure.axes)


def test_groups_are_datasets_and_a_missing_one_is_named(table: Table) -> None:
    assert table.to_xarray("clicks").basis_function.dims == ("function", "sample")
    with pytest.raises(TableError, match=r"has no group 'click'; its groups are .*clicks, coherent_sweep"):
        table.to_xarray("click")
    assert repr(table).startswith(f"<Table {table.path}: ") and "best rows" in table._repr_html_()


def test_names_from_a_file_cannot_become_markup(tmp_path: Path, click_table: Path) -> None:
    path = tmp_path / "<b>.nc"
    path.write_bytes(click_table.read_bytes())
    with Table.open(path) as table:
        assert "<b>.nc" not in table._repr_html_()
