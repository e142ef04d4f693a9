"""Laws of a table with clicks: what it holds, and what of it comes first."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.table.history import previous_of
from engine.touch.placement import Places
from precompute.builder.table_build import EARLY_IN_PLACE, build_table
from precompute.clicks import ClickOptions
from precompute.clicks.click_basis import lines_for
from precompute.clicks.click_plants import count_modes
from precompute.clicks.tabulated import tabulated_keys
from tests.precompute.fleet.small_fleet import small_text

pytestmark = pytest.mark.long

CHEAP = ClickOptions(pitch_m=93.2e-3, pool=90, judged=20)
DEVICE = Device.parse(small_text(), "bar")
PLACES = Places(DEVICE.bar.length_m, 4)
CLICKS = 4 + 3 * 6  # one finger at each place, and the roles of each pair


def build(path: Path, device: Device = DEVICE, clicks_up_to: int = 2, **stop: int) -> list[str]:
    """Build a table; `stop`: after so many clicks by Ctrl-C. Returns the steps that were told."""
    told = list[str]()

    def progress(step: str, fraction: float) -> None:
        assert 0 <= fraction <= 1
        told.append(step)
        if told.count("clicks") == stop.get("clicks"):
            raise KeyboardInterrupt

    build_table(device, path, created="", clicks_up_to=clicks_up_to, click_options=CHEAP, progress=progress)
    return told


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clicks") / "bar.nc"
    build(path)
    return path


@pytest.fixture(scope="module")
def table(path: Path) -> Table:
    return Table.open(path)


def test_every_placement_of_one_and_two_fingers_has_its_click_and_the_table_says_how_it_was_made(table: Table) -> None:
    assert table.places == PLACES and len(table.clicks) == CLICKS
    keys = {table.clicks.key_of(row) for row in range(CLICKS)}
    assert keys == set(tabulated_keys(PLACES, 2)) and len(keys) == CLICKS
    tolerance_m = PLACES.pitch_m / 2 + 1e-3
    assert table.attributes["click_pitch_m"] == PLACES.pitch_m
    assert table.attributes["click_tolerance_m"] == pytest.approx(tolerance_m)
    assert all(click.tolerance_m == pytest.approx(tolerance_m) for click in table.clicks)
    assert table.attributes["click_modes"] == count_modes(DEVICE, lines_for(DEVICE, CHEAP.length_s))


def test_other_programs_make_the_waveforms_of_basis_and_weights(path: Path, table: Table) -> None:
    with xarray.open_dataset(path, group="clicks") as clicks:
        assert clicks.basis_function.dims == ("function", "sample")
        assert list(clicks.actuator.values) == [actuator.name for actuator in DEVICE.actuators]
        assert clicks.sample.attrs["units"] == "s"
        for row, click in enumerate(table.clicks):
            mine = np.flatnonzero(clicks.function_set.values == int(clicks.basis_set[row]))
            weights = clicks.weight[row, : len(mine)].values * 0.5 ** int(clicks.fraction_bits[row])
            parts = weights[:, None] * clicks.basis_function[mine].values
            players = clicks.function_actuator.values[mine]
            found = np.stack([parts[players == actuator].sum(axis=0) for actuator in range(2)], axis=1)
            assert found == pytest.approx(click.samples / 32767, abs=0.51 / 32767)
            assert abs(click.samples).max() <= 32767 * DEVICE.limits.amplitude
        assert all(
            "long_name" in variable.attrs and "units" in variable.attrs for variable in clicks.variables.values()
        )


def test_clicks_for_few_fingers_only(tmp_path: Path) -> None:
    build(tmp_path / "bar.nc", clicks_up_to=1)
    with Table.open(tmp_path / "bar.nc") as few:
        assert [click.placement.position_m for click in few.clicks] == [(at_m,) for at_m in PLACES.position_m]
    assert "clicks" not in build(tmp_path / "none.nc", clicks_up_to=0)
    with Table.open(tmp_path / "none.nc") as none:
        assert not none.clicks and none.places == PLACES
    with pytest.raises(TableError, match="clicks of up to 3 fingers"):
        build(tmp_path / "none.nc", clicks_up_to=3)


def test_an_interrupted_build_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        build(tmp_path / "bar.nc", clicks=7)
    assert not list(tmp_path.iterdir())


@pytest.mark.machine(stall_s=None)
def test_the_cost_is_of_what_was_solved_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts do not depend on the number of workers; processor time of workers counts; what is taken over is free."""
    monkeypatch.setattr("precompute.clicks.tabulated._PAYS", 1)  # these clicks alone would start no worker
    path = tmp_path / "bar.nc"
    with_workers = build_table(DEVICE, path, click_options=CHEAP, workers=2)
    alone = build_table(DEVICE, path, click_options=CHEAP, reuse=False)
    assert with_workers.clicks == alone.clicks == CLICKS
    assert all(taken_s > 0 for taken_s in alone.processor_s.values())
    # The processes of two workers each take a start of their own, which is longer than these clicks.
    assert with_workers.processor_s["clicks"] > 0.5
    again = build_table(DEVICE, path, click_options=CHEAP)
    assert again.clicks == again.processor_s["sweep"] == again.processor_s["clicks"] == 0


def build_early(path: Path, **options: object) -> tuple[int, list[list[ClickEntry]]]:
    """Build with an early table: how many clicks were solved, and those of each early table that was put in place."""
    early = list[list[ClickEntry]]()

    def progress(step: str, _fraction: float) -> None:
        if step == EARLY_IN_PLACE:
            with Table.open(path, device=DEVICE) as first:
                early.append(list(first.clicks))

    wanted = {"click_options": CHEAP, "early": True, "progress": progress} | options
    return build_table(DEVICE, path, **wanted).clicks, early  # type: ignore[arg-type]  # by name


def test_an_early_table_is_whole_has_the_clicks_of_one_finger_and_is_completed(tmp_path: Path, table: Table) -> None:
    path = tmp_path / "bar.nc"
    build_table(DEVICE, path, created="before", clicks_up_to=0)
    clicks, (early,) = build_early(path)
    assert clicks == 4 + CLICKS
    assert len(early) == 4 and all(len(click.placement.position_m) == 1 for click in early)
    with Table.open(path, device=DEVICE) as whole:
        for one, other in zip(whole.clicks, table.clicks, strict=True):
            assert np.array_equal(one.samples, other.samples)
            for figure in ("placement", "felt", "quiet", "fingers", "exceeds_s"):
                assert getattr(one, figure) == getattr(other, figure)
    with Table.open(previous_of(path)) as previous:
        assert previous.attributes["created"] == "before"  # the whole table only completes the early one


def test_no_early_table_is_made_where_clicks_are_there_or_one_finger_is_all(tmp_path: Path) -> None:
    path = tmp_path / "bar.nc"
    assert build_early(path, clicks_up_to=1) == (4, [])
    assert build_early(path) == (CLICKS, [])
    assert build_early(path) == (0, [])
