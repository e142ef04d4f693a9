"""Laws of a table with clicks: what it holds, and what an interrupted build need not solve again."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from engine.device import Device
from engine.table import ClickEntry, Table
from engine.touch import ZoneState
from precompute.builder.build import build_table
from precompute.clicks import ClickOptions, ClickSolver
from precompute.clicks.basis import EVALUATION_RATE_HZ
from precompute.clicks.store import ClickStore
from precompute.entries.solver import tabulated_states
from tests.engine.made_clicks import basis_of, click_of
from tests.precompute.builder.test_build import SMALL

CHEAP = ClickOptions(lengths_s=(0.02,), scenarios=4, trimmed=10, judged=20)
DEVICE = Device.parse(SMALL, "bar")
STATES = 19  # 3^3 - 2^3


def build(path: Path, device: Device = DEVICE, clicks_up_to: int | None = None, **stop: int) -> list[str]:
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
        and (one.states, one.felt, one.quiet, one.zones) == (other.states, other.felt, other.quiet, other.zones)
        and one.exceeds_s == other.exceeds_s
    )


def test_every_state_with_a_felt_zone_has_its_click(table: Table) -> None:
    assert [click.states for click in table.clicks] == tabulated_states(DEVICE)
    assert len(table.clicks) == STATES


def test_a_click_s_figures_of_the_nominal_plant_agree_with_its_verdict(table: Table) -> None:
    for click in table.clicks:
        levels = {kind: [] for kind in ZoneState}  # type: dict[ZoneState, list[float]]
        for state, zone in zip(click.states, click.zones, strict=True):
            assert (zone is None) == (state is ZoneState.FREE)
            if zone is not None:
                levels[state].append(zone.level_db)
        # Two ways to the same figure: closed-form sample responses, and the time-domain plant at a finer step.
        assert min(levels[ZoneState.FELT]) == pytest.approx(click.felt.nominal_db, abs=0.06)
        if click.quiet is not None:
            assert max(levels[ZoneState.QUIET]) == pytest.approx(click.quiet.nominal_db, abs=0.06)
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
        assert [click.fingers for click in few.clicks] == [1] * 3
    assert "clicks" not in build(tmp_path / "none.nc", clicks_up_to=0)
    with Table.open(tmp_path / "none.nc") as none:
        assert none.clicks == ()


def test_an_interrupted_build_goes_on_where_its_clicks_were(tmp_path: Path, table: Table) -> None:
    path = tmp_path / "bar.nc"
    with pytest.raises(KeyboardInterrupt):
        build(path, clicks=7)
    assert [kept.name for kept in tmp_path.iterdir()] == [".bar.nc.clicks"]
    assert build(path).count("clicks") == STATES - 7
    assert [kept.name for kept in tmp_path.iterdir()] == ["bar.nc"]
    with Table.open(path) as resumed:
        assert all(same(one, other) for one, other in zip(resumed.clicks, table.clicks, strict=True))


def test_the_cost_is_of_what_was_solved_now(tmp_path: Path) -> None:
    """Counts do not depend on the number of workers; processor time of workers counts; what is taken over is free."""
    path = tmp_path / "bar.nc"
    with_workers = build_table(DEVICE, path, click_options=CHEAP, workers=2)
    alone = build_table(DEVICE, path, click_options=CHEAP, reuse=False)
    assert with_workers.states == with_workers.clicks == alone.clicks == STATES
    assert with_workers.effort == alone.effort
    plants = sum(1 + count for count in (CHEAP.scenarios, CHEAP.trimmed, CHEAP.judged))
    assert alone.effort.plants == plants * 7  # sets of fingers
    assert alone.effort.programs > STATES and alone.effort.pivots > 0 and alone.effort.fallbacks == 0
    assert all(taken_s > 0 for taken_s in alone.processor_s.values())
    # The processes of two workers each take a start of their own, which is longer than these clicks.
    assert with_workers.processor_s["clicks"] > 0.5
    again = build_table(DEVICE, path, click_options=CHEAP)
    assert (again.states, again.clicks, again.effort.programs) == (0, 0, 0)
    assert again.processor_s["entries"] == again.processor_s["sweep"] == 0


def test_a_store_that_was_cut_anywhere_gives_what_was_whole(tmp_path: Path) -> None:
    clicks, basis = [click_of(DEVICE, states) for states in tabulated_states(DEVICE)[:4]], basis_of(2, 121)
    with ClickStore(tmp_path / "bar.nc", "it", basis) as store:
        for click in clicks:
            store.add(click)
    data = store.path.read_bytes()
    ends = [end for end in range(len(data)) if data[end : end + 1] == b"\n"]
    for size in {0, 1, 40, *ends, *(end + 5 for end in ends), len(data) - 1}:
        store.path.write_bytes(data[:size])
        with ClickStore(tmp_path / "bar.nc", "it", basis) as cut:
            whole = max(0, sum(end <= size for end in ends) - 1)
            assert [same(one, other) for one, other in zip(cut.clicks.values(), clicks, strict=False)] == [True] * whole
            assert len(cut.clicks) == whole


def test_a_store_of_another_device_is_dropped(tmp_path: Path) -> None:
    with ClickStore(tmp_path / "bar.nc", "one", basis_of(2, 121)) as store:
        store.add(click_of(DEVICE, tabulated_states(DEVICE)[0]))
    with ClickStore(tmp_path / "bar.nc", "other", basis_of(2, 121)) as other:
        assert not other.clicks
    assert not other.path.exists()


def test_a_table_states_the_modes_of_its_clicks(table: Table) -> None:
    assert table.attributes["click_modes"] == ClickSolver(DEVICE, CHEAP).modes
