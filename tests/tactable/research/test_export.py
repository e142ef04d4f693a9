"""The command `export`: every format has the numbers of the table, and what is not there is told."""

from pathlib import Path

import numpy as np
import pandas
import pytest
import xarray
from scipy.io import loadmat

from engine.device import Device
from engine.table import Table
from precompute.builder.table_build import build_table
from tactable.research.table_export import write_csv
from tests.precompute.builder.test_table_build import SMALL
from tests.tactable.cli.in_process import run_here


@pytest.mark.parametrize("group", ["coherent_sweep", "best_rows", "clicks"])
def test_matlab_and_netcdf_hold_every_array_of_a_part(click_table: Path, tmp_path: Path, group: str) -> None:
    for ending in ("mat", "nc"):
        done = run_here(tmp_path, "export", str(click_table), group, "-o", f"part.{ending}")
        assert done.returncode == 0, done.stderr
    struct = loadmat(tmp_path / "part.mat", simplify_cells=True)[group]
    with xarray.open_dataset(click_table, group=group) as own, xarray.open_dataset(tmp_path / "part.nc") as copied:
        xarray.testing.assert_equal(own, copied)
        for name, array in own.variables.items():
            found = np.asarray(struct[str(name)])
            if array.dtype.kind in "OU":
                assert found.ravel().tolist() == array.values.ravel().tolist()
            else:
                np.testing.assert_array_equal(found.reshape(array.shape), array.values)
            assert struct["units"][str(name)] == array.attrs.get("units", "1")


def test_a_line_of_the_sweep_has_the_figures_of_every_zone(click_table: Path, tmp_path: Path) -> None:
    assert run_here(tmp_path, "export", str(click_table), "sweep", "-o", "sweep.csv").returncode == 0
    rows = pandas.read_csv(tmp_path / "sweep.csv")
    with Table.open(click_table) as table:
        hz, steps = table.device.sweep.frequency_hz, table.device.sweep.amplitude
        factor = table.localized_factor(["II"])
    assert len(rows) == factor.size
    line = rows.set_index(["frequency_1", "frequency_2", "amplitude_1", "amplitude_2"])["localized_factor II"]
    assert np.float32(line.loc[(hz[2], hz[1], steps[2], steps[1])].item()) == factor[2, 1, 2, 1]


def test_lines_of_clicks_have_the_points_of_their_fingers(tmp_path: Path) -> None:
    """Two columns a finger on a plate; none where a click has fewer fingers."""
    axes = {"place": [0.0, 0.1, 0.1], "place_across": ("place", [0.0, 0.0, 0.05])}
    places = np.array([[0, 2], [1, -1]], np.int32)
    clicks = xarray.Dataset({"finger_place": (("click", "finger"), places), **axes})
    write_csv(clicks, "clicks", tmp_path / "clicks.csv")
    rows = pandas.read_csv(tmp_path / "clicks.csv")
    assert rows["finger_position 0"].tolist() == [0.0, 0.1] and rows["finger_position_across 0"].tolist() == [0.0, 0.0]
    other = rows[["finger_position 1", "finger_position_across 1"]].to_numpy()
    assert other[0].tolist() == [0.1, 0.05] and np.isnan(other[1]).all()


def test_a_table_without_its_sweep_plays_its_rows_and_says_what_it_lacks(click_table: Path, tmp_path: Path) -> None:
    device = Device.parse(SMALL.replace("[sweep]", "[sweep]\nstore = false"), "bar.toml")
    build_table(device, tmp_path / "small.nc", clicks_up_to=0)
    with Table.open(tmp_path / "small.nc") as table, Table.open(click_table) as whole:
        assert not {"sweep", "coherent_sweep"} & {name.partition("/")[0] for name in table.checksums()}
        assert table.best_row(["I", "III"]) == whole.best_row(["I", "III"])
    done = run_here(tmp_path, "export", "small.nc", "sweep", "-o", "sweep.csv")
    assert done.returncode == 1 and "[sweep] store" in done.stderr
    assert not (tmp_path / "sweep.csv").exists()
    assert run_here(tmp_path, "plot", "factor", "small.nc", "-o", "factor.png").returncode == 1
