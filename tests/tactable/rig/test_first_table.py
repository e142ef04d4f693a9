"""The first table of a device: made of modes."""

from pathlib import Path

from engine.table import Table
from precompute.clicks.click_basis import click_basis
from precompute.clicks.click_options import read_click_options
from precompute.sweep.tabulate import find_best_rows
from tactable.rig.ready import (
    early_options,
    is_first,
    open_first_table,
    solve_first_click,
    write_first_table,
)
from tactable.shipped import find_device


def test_it_is_a_table_without_clicks_and_with_compiled_kernels_has_the_rows_of_a_sweep(tmp_path: Path) -> None:
    device = find_device("reference-d")
    with open_first_table(device, tmp_path / "rows.nc", has_rows=True) as table:
        assert table.best_rows == find_best_rows(device) and len(table.best_rows) == 31
    with open_first_table(device, tmp_path / "first.nc") as table:
        assert is_first(table) and not table.is_shipped
        assert len(table.clicks) == 0
        assert table.device.fingerprint == device.fingerprint
        assert table.modes.drive.shape[1] == len(device.actuators)


def test_with_the_first_click_it_has_the_basis_that_all_clicks_of_the_device_share(tmp_path: Path) -> None:
    device, path = find_device("reference-d"), tmp_path / "first.nc"
    clicks = solve_first_click(device)
    write_first_table(device, path, clicks)
    with Table.open(path, device=device) as table:
        assert is_first(table) and len(table.clicks) == 1
        assert read_click_options(table) == early_options()
        assert table.clicks.basis is not None
        assert table.clicks.basis.hash == click_basis(device, early_options()).hash
        assert table.places == early_options().places(device.bar.length_m)
        assert table.clicks.tolerance_m == early_options().at(table.places, device.spread).tolerance_m
