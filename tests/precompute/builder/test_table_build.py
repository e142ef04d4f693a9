"""Laws of a built table: its figures are the dense model's, memory does not matter, it is complete or not there."""

import itertools
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import xarray as xr

from base.arrays import Array, Complex
from engine.device import Device
from engine.table import Table, TableError
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.table_build import build_table, table_bytes
from precompute.sweep.grid import zone_points
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import reference_text
from tests.quick import first_quick

SMALL = reference_text(
    {
        'step = "1 Hz"': 'step = "20 Hz"',
        "amplitude_steps = 5": "amplitude_steps = 2",
        "phase_steps = 36": "phase_steps = 12",
        "count = 5": "count = 3",
    }
)
THIRD = """
[[actuator]]
name = "middle"
position = "45 %"
stiffness = "12 kN/m"
damping = "0.1 N*s/m"
mass = "3 g"
full_scale = "0.8 µm"
band = ["100 Hz", "240 Hz"]
"""
ONE_LEVEL = SMALL.replace('"10 dB", "20 dB", "30 dB"', '"20 dB"')
DEVICES = {
    "two": Device.parse(SMALL.replace('"20 dB", "30 dB"', '"20 dB"'), "two"),
    "three": Device.parse(ONE_LEVEL.replace("\n[zones]", f"{THIRD}\n[zones]"), "three"),
    "one": Device.parse(ONE_LEVEL[: ONE_LEVEL.rindex("[[actuator]]")] + ONE_LEVEL[ONE_LEVEL.index("[zones]") :], "one"),
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {'step = "1 Hz"': 'step = "2.5 mHz"', "amplitude_steps = 5": "amplitude_steps = 100"},
            r"takes 5\.6. PB, and .* free there: make the sweep coarser",
        ),
        (
            {"amplitude_steps = 5": "amplitude_steps = 100", "phase_steps = 36": "phase_steps = 360"},
            r"takes .* of memory, and this machine has .*: make the sweep coarser",
        ),
    ],
)
def test_a_table_without_room_is_refused_before_it_is_begun(
    changes: dict[str, str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "memory" in message:
        monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(total=1 << 60, free=1 << 60))
    with pytest.raises(TableError, match=message):
        build_table(Device.parse(reference_text(changes), "great"), tmp_path / "great.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", DEVICES)
def test_the_estimate_is_the_size_of_the_table(folder: Path, name: str) -> None:
    with h5py.File(folder / f"{name}.nc") as file:
        held = sum(
            array.nbytes
            for group in ("responses", "sweep", "coherent_sweep")
            if group in file
            for array in file[group].values()
        )
    assert 0.9 * held < table_bytes(DEVICES[name]) <= 1.1 * held


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    for name, device in DEVICES.items():
        build_table(device, folder / f"{name}.nc", created="2024-01-01", clicks_up_to=0)
    return folder


def opened(folder: Path, name: str) -> Table:
    return Table.open(folder / f"{name}.nc", device=DEVICES[name], code_fingerprint=code_fingerprint())


@pytest.mark.parametrize("group", ["responses", "sweep", "coherent_sweep", "best_rows"])
def test_every_group_opens_in_xarray_with_units_and_labels(folder: Path, group: str) -> None:
    with xr.open_dataset(folder / "two.nc", group=group, engine="h5netcdf") as data:
        assert data.variables
        for name, variable in data.variables.items():
            assert variable.attrs["units"], name
            assert variable.attrs["long_name"], name
        assert {"zone"} <= set(data.coords)
        assert data["zone"].values.tolist() == ["I", "II", "III"]


def drive(
    device: Device, pair: tuple[int, int], hz: tuple[float, float], amplitude: tuple[complex, complex]
) -> tuple[Array, Complex]:
    frequency_hz, weights = np.full(len(device.actuators), 1.0), np.zeros(len(device.actuators), dtype=np.complex128)
    frequency_hz[list(pair)], weights[list(pair)] = hz, amplitude
    return frequency_hz, weights


@pytest.mark.parametrize("name", first_quick(["three", "two"]))
@pytest.mark.parametrize("diagonal", first_quick([True, False]))
def test_the_pair_sweep_is_the_dense_models(folder: Path, name: str, diagonal: bool) -> None:
    device, random = DEVICES[name], np.random.default_rng(0)
    model, hz, amplitude = DenseModel(device), device.sweep.frequency_hz, device.sweep.amplitude
    pairs = list(itertools.combinations(range(len(device.actuators)), 2))
    points = zone_points(device).shape[1]
    with opened(folder, name) as table:
        for _ in range(8):
            p, (f1, f2), (a, b) = int(random.integers(len(pairs))), random.integers(3, 9, 2), random.integers(1, 3, 2)
            f2 = f1 if diagonal else (f2 if f2 != f1 else f2 + 1)
            played = drive(device, pairs[p], (hz[f1], hz[f2]), (amplitude[a], amplitude[b]))
            expected, looked_at = model.figures(*played), model.figures(*played, points)
            for z, zone in enumerate(device.zones):
                at = (f1, f2, a, b)
                assert table.localized_factor([zone.name], p)[at] == pytest.approx(expected.share[z], rel=1e-4)
                assert table.peak_acceleration([zone.name], p)[at] == pytest.approx(expected.peak[z], rel=1.5e-3)
                dead = table.dead_spot([zone.name], p)[at]  # of the points looked at: between them it may be less
                assert dead == pytest.approx(looked_at.dead[z], rel=1e-4, abs=1e-6 * looked_at.peak[z])


@pytest.mark.parametrize("name", ["two", "three"])
def test_the_sweep_is_nan_only_where_nothing_moves_or_a_band_forbids(folder: Path, name: str) -> None:
    device = DEVICES[name]
    hz = device.sweep.frequency_hz
    in_band = [(hz >= actuator.band_hz[0]) & (hz <= actuator.band_hz[1]) for actuator in device.actuators]
    with opened(folder, name) as table:
        for p, (i, j) in enumerate(itertools.combinations(range(len(device.actuators)), 2)):
            allowed = np.broadcast_to((in_band[i][:, None] & in_band[j])[:, :, None, None], (13, 13, 3, 3)).copy()
            allowed[:, :, 0, 0] = False
            for figure in (table.localized_factor, table.peak_acceleration, table.dead_spot):
                assert (np.isfinite(figure(["I"], p)) == allowed).all()


@pytest.mark.parametrize("name", first_quick(["three", "two"]))
def test_the_coherent_sweep_is_the_dense_models(folder: Path, name: str) -> None:
    device, random = DEVICES[name], np.random.default_rng(1)
    model, hz = DenseModel(device), device.sweep.frequency_hz
    pairs = list(itertools.combinations(range(len(device.actuators)), 2))
    with opened(folder, name) as table:
        values = {n: table.values("coherent_sweep", n) for n in ("localized_factor", "peak_acceleration", "dead_spot")}
        first, second, phase = (table.values("coherent_sweep", n) for n in ("amplitude_1", "amplitude_2", "phase"))
        for _ in range(8):
            p, f, r, s = (int(random.integers(n)) for n in (len(pairs), 7, len(first), len(phase)))
            f += 2
            amplitude = (complex(first[r]), complex(second[r] * np.exp(1j * phase[s])))
            played = drive(device, pairs[p], (hz[f], hz[f]), amplitude)
            expected, looked_at = model.figures(*played), model.figures(*played, zone_points(device).shape[1])
            assert values["localized_factor"][p, f, :, r, s] == pytest.approx(expected.share, rel=1e-3)
            assert values["peak_acceleration"][p, f, :, r, s] == pytest.approx(expected.peak, rel=1.5e-3)
            assert values["dead_spot"][p, f, :, r, s] == pytest.approx(looked_at.dead, rel=1e-3, abs=1e-5)


def contents(path: Path) -> dict[str, object]:
    """Bytes of every number array, lists of every text array, by name."""
    found = dict[str, object]()

    def keep(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = item[...].tolist() if item.dtype.kind == "O" else item[...].tobytes()

    with h5py.File(path) as file:
        file.visititems(keep)
    return found


@pytest.mark.parametrize(
    ("name", "budget"),
    [
        ("two", 20_000),
        *(pytest.param(*case, marks=pytest.mark.long) for case in (("two", 1 << 30), ("three", 50_000))),
    ],
)
def test_the_memory_budget_does_not_change_a_byte_and_progress_only_grows(
    folder: Path, tmp_path: Path, name: str, budget: int
) -> None:
    told = list[tuple[str, float]]()
    build_table(
        DEVICES[name],
        tmp_path / "other.nc",
        created="2024-01-01",
        clicks_up_to=0,
        memory_budget_bytes=budget,
        progress=lambda *step: told.append(step),
    )
    assert contents(tmp_path / "other.nc") == contents(folder / f"{name}.nc")
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions) and told[-1] == ("done", 1.0)


def test_a_bar_with_one_actuator_has_a_table_without_pairs(folder: Path) -> None:
    with opened(folder, "one") as table:
        assert table.drive_for(["I"]).achieved
        with pytest.raises(TableError, match="pair"):
            table.localized_factor(["I"])


class Stop:
    """Progress that raises at its n-th call."""

    def __init__(self, error: type[BaseException], calls: int) -> None:
        self.error, self.left = error, calls

    def __call__(self, step: str, fraction: float) -> None:
        self.left -= 1
        if not self.left:
            raise self.error(f"{step}: {fraction}")


@pytest.mark.parametrize(
    ("error", "calls"),
    [
        (RuntimeError, 2),
        (KeyboardInterrupt, 6),
        *(pytest.param(RuntimeError, calls, marks=pytest.mark.long) for calls in (1, 4, 6)),
        *(pytest.param(KeyboardInterrupt, calls, marks=pytest.mark.long) for calls in (1, 2, 4)),
    ],
)
def test_an_exception_on_the_way_leaves_nothing(
    folder: Path, tmp_path: Path, error: type[BaseException], calls: int
) -> None:
    older = tmp_path / "older.nc"
    older.write_bytes((folder / "three.nc").read_bytes())
    for path in (older, tmp_path / "new.nc"):
        with pytest.raises(error):
            build_table(
                DEVICES["two"], path, created="", clicks_up_to=0, memory_budget_bytes=1, progress=Stop(error, calls)
            )
    assert [path.name for path in tmp_path.iterdir()] == ["older.nc"]
    assert older.read_bytes() == (folder / "three.nc").read_bytes()
