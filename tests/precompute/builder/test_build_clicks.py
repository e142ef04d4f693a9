"""Laws of a table with clicks: what it holds, and what an interrupted build need not solve again."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.table.history import previous_of
from engine.touch.places import Places
from precompute.builder.build import COARSE_IN_PLACE, Coarse, build_table
from precompute.clicks import ClickOptions, ClickSolver
from precompute.clicks.basis import EVALUATION_RATE_HZ
from precompute.clicks.store import ClickStore
from precompute.clicks.tabulated import tabulated_keys
from tests.engine.made_clicks import basis_of, click_of
from tests.precompute.fleet.small_fleet import small_text

pytestmark = pytest.mark.long

CHEAP = ClickOptions(lengths_s=(0.02,), pitch_m=93.2e-3, scenarios=4, trimmed=10, judged=20)
DEVICE = Device.parse(small_text(), "bar")
PLACES = Places(DEVICE.bar.length_m, 4)
KEYS = tabulated_keys(PLACES, 2)
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


def same(one: ClickEntry, other: ClickEntry) -> bool:
    return (
        np.array_equal(one.samples, other.samples)
        and (one.placement, one.felt, one.quiet, one.fingers)
        == (other.placement, other.felt, other.quiet, other.fingers)
        and one.exceeds_s == other.exceeds_s
    )


def test_every_placement_of_one_and_two_fingers_has_its_click(table: Table) -> None:
    assert table.places == PLACES and len(table.clicks) == CLICKS
    keys = {table.clicks.key_of(row) for row in range(CLICKS)}
    assert keys == set(tabulated_keys(PLACES, 2)) and len(keys) == CLICKS


def test_a_table_says_how_far_fingers_may_lie_from_their_places(table: Table) -> None:
    tolerance_m = PLACES.pitch_m / 2 + 1e-3
    assert table.attributes["click_pitch_m"] == PLACES.pitch_m
    assert table.attributes["click_tolerance_m"] == pytest.approx(tolerance_m)
    assert all(click.tolerance_m == pytest.approx(tolerance_m) for click in table.clicks)
    assert "clicks_are_coarse" not in table.attributes


def test_a_click_s_figures_of_the_nominal_plant_agree_with_its_evaluation(table: Table) -> None:
    for click in table.clicks:
        levels_db = [finger.level_db for finger in click.fingers]
        # Two ways to the same figure: closed-form sample responses, and the time-domain plant at a finer step.
        assert min(levels_db[i] for i in click.placement.felt) == pytest.approx(click.felt.nominal_db, abs=0.06)
        assert click.felt.worst_db <= click.felt.low_db <= click.felt.middle_db <= click.felt.high_db
        if click.quiet is not None:
            quiet_db = max(levels_db[i] for i in click.placement.quiet)
            assert quiet_db == pytest.approx(click.quiet.nominal_db, abs=0.06)
            assert click.quiet.worst_db >= click.quiet.high_db
        softest, *_, full = click.exceeds_s.values()
        assert full is not None
        assert softest is None or full <= softest
        assert full <= click.peak_s + 1 / EVALUATION_RATE_HZ


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


def test_an_interrupted_build_goes_on_where_its_clicks_were(tmp_path: Path, table: Table) -> None:
    path = tmp_path / "bar.nc"
    with pytest.raises(KeyboardInterrupt):
        build(path, clicks=7)
    assert [kept.name for kept in tmp_path.iterdir()] == [".bar.nc.clicks"]
    assert build(path).count("clicks") == CLICKS - 7
    assert [kept.name for kept in tmp_path.iterdir()] == ["bar.nc"]
    with Table.open(path) as resumed:
        assert all(same(one, other) for one, other in zip(resumed.clicks, table.clicks, strict=True))


@pytest.mark.machine
def test_the_cost_is_of_what_was_solved_now(tmp_path: Path) -> None:
    """Counts do not depend on the number of workers; processor time of workers counts; what is taken over is free."""
    path = tmp_path / "bar.nc"
    with_workers = build_table(DEVICE, path, click_options=CHEAP, workers=2)
    alone = build_table(DEVICE, path, click_options=CHEAP, reuse=False)
    assert with_workers.clicks == alone.clicks == CLICKS
    assert with_workers.effort == alone.effort
    plants = sum(1 + count for count in (CHEAP.scenarios, CHEAP.trimmed, CHEAP.judged))
    assert alone.effort.plants == plants * (4 + 6)  # sets of fingers
    assert alone.effort.programs > CLICKS and alone.effort.pivots > 0 and alone.effort.fallbacks == 0
    assert all((taken_s > 0) == (step != "coarse clicks") for step, taken_s in alone.processor_s.items())
    # The processes of two workers each take a start of their own, which is longer than these clicks.
    assert with_workers.processor_s["clicks"] > 0.5
    again = build_table(DEVICE, path, click_options=CHEAP)
    assert (again.clicks, again.effort.programs) == (0, 0)
    assert again.processor_s["sweep"] == 0


def test_a_store_that_was_cut_anywhere_gives_what_was_whole(tmp_path: Path) -> None:
    clicks, basis = [click_of(DEVICE, PLACES.placement(key)) for key in KEYS[:4]], basis_of(2, 121)
    with ClickStore(tmp_path / "bar.nc", "it", basis, PLACES) as store:
        for click in clicks:
            store.add(click)
    data = store.path.read_bytes()
    ends = [end for end in range(len(data)) if data[end : end + 1] == b"\n"]
    for size in {0, 1, 40, *ends, *(end + 5 for end in ends), len(data) - 1}:
        store.path.write_bytes(data[:size])
        with ClickStore(tmp_path / "bar.nc", "it", basis, PLACES) as cut:
            whole = max(0, sum(end <= size for end in ends) - 1)
            assert [same(one, other) for one, other in zip(cut.clicks.values(), clicks, strict=False)] == [True] * whole
            assert len(cut.clicks) == whole


def test_a_store_of_another_device_is_dropped(tmp_path: Path) -> None:
    with ClickStore(tmp_path / "bar.nc", "one", basis_of(2, 121), PLACES) as store:
        store.add(click_of(DEVICE, PLACES.placement(KEYS[0])))
    with ClickStore(tmp_path / "bar.nc", "other", basis_of(2, 121), PLACES) as other:
        assert not other.clicks
    assert not other.path.exists()


def test_a_table_states_the_modes_of_its_clicks(table: Table) -> None:
    assert table.attributes["click_modes"] == ClickSolver(DEVICE, CHEAP).modes


ROUGH = ClickOptions(lengths_s=(0.02,), pitch_m=140e-3, scenarios=22, trimmed=24, judged=24)
"""Coarse clicks of these are solved on fewer plants."""


def test_a_coarse_table_is_whole_and_comes_first_where_there_are_no_clicks(tmp_path: Path) -> None:
    path, kept = tmp_path / "bar.nc", tmp_path / "kept.nc"
    build_table(DEVICE, path, created="before", clicks_up_to=0)

    def progress(step: str, _fraction: float) -> None:
        if step == COARSE_IN_PLACE:
            kept.write_bytes(path.read_bytes())

    cost = build_table(
        DEVICE, path, clicks_up_to=1, click_options=ROUGH, coarse=Coarse.FIRST, reuse=False, progress=progress
    )
    assert (cost.coarse_clicks, cost.clicks) == (3, 3)
    with Table.open(kept, device=DEVICE) as rough, Table.open(path, device=DEVICE) as fine:
        assert rough.is_coarse and not fine.is_coarse
        assert rough.best_rows == fine.best_rows and rough.places == fine.places
        assert not all(same(one, other) for one, other in zip(rough.clicks, fine.clicks, strict=True))
    with Table.open(previous_of(path)) as previous:
        assert previous.attributes["created"] == "before"  # the fine table only completes the coarse one


def test_a_coarse_table_is_not_made_again_and_the_fine_one_follows(tmp_path: Path) -> None:
    path = tmp_path / "bar.nc"
    wanted = {"clicks_up_to": 1, "click_options": ROUGH}
    only = build_table(DEVICE, path, coarse=Coarse.ONLY, **wanted)  # type: ignore[arg-type]  # by name
    assert (only.coarse_clicks, only.clicks) == (3, 0)
    then = build_table(DEVICE, path, coarse=Coarse.FIRST, **wanted)  # type: ignore[arg-type]  # by name
    assert (then.coarse_clicks, then.clicks) == (0, 3)
    again = build_table(DEVICE, path, coarse=Coarse.FIRST, **wanted)  # type: ignore[arg-type]  # by name
    assert (again.coarse_clicks, again.clicks) == (0, 0)
