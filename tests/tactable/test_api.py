"""What `from tactable import ...` gives: examples in docstrings run, names resolve, nothing heavy is loaded early."""

import doctest
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import import_module, resources
from pathlib import Path

import pytest

import tactable
from engine.device import DeviceError
from engine.table import TableError
from tactable import Device, Table, build_table, calibrate, calibrated_device, find_device, read_measurements
from tests.small_device import small_text
from tests.tactable.click_table import CHEAP

DRIFTED = Path(__file__).parents[2] / "tables" / "measurements" / "reference-a-drifted.csv"
EXAMPLES = (
    *(Device.read, Device.with_values, build_table, Table.open, Table.best_row, calibrate),
    *(tactable.placement, tactable.modes, tactable.response, Table.click_for, Table.drive_for, Table.to_xarray),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the examples find where they run."""
    folder = tmp_path_factory.mktemp("api")
    (folder / "my-bar.toml").write_text(small_text(), encoding="utf-8")
    (folder / "reference-a.toml").write_text(find_device("reference-a").text, encoding="utf-8")
    shutil.copy(DRIFTED, folder / "measured.csv")
    build_table(Device.read(folder / "my-bar.toml"), folder / "my-bar.nc", clicks_up_to=1, click_options=CHEAP)
    return folder


@pytest.mark.parametrize("public", EXAMPLES, ids=lambda public: public.__qualname__)
def test_its_example_runs(public: object, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(shutil.copytree(folder, tmp_path / "here"))
    names = {name: getattr(tactable, name) for name in tactable.__all__} | {"device": Device.read("my-bar.toml")}
    (example,) = doctest.DocTestFinder(recurse=False).find(public, "example", globs=names)
    assert example.examples
    assert doctest.DocTestRunner(verbose=False).run(example).failed == 0


def test_every_public_name_is_where_it_is_said_to_be() -> None:
    for name, home in tactable._HOMES.items():
        assert getattr(tactable, name) is getattr(import_module(home), name)
    assert set(tactable.__all__) <= set(dir(tactable))
    with pytest.raises(AttributeError, match="no attribute 'open_tables'"):
        tactable.open_tables  # noqa: B018  # being asked for is what is tested


def loaded_by(statement: str) -> set[str]:
    """Top-level packages that a fresh interpreter has loaded after it."""
    program = f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.machine(stall_s=None)
def test_importing_loads_what_is_used_and_no_more() -> None:
    assert loaded_by("import tactable").isdisjoint({"engine", "numpy", "precompute", "numba"})
    assert loaded_by("from tactable import Device, Table").isdisjoint({"precompute", "numba", "matplotlib"})


def test_a_table_belongs_to_its_device_and_zones_in_one_text_are_not_read_letter_by_letter(folder: Path) -> None:
    device = Device.read(folder / "my-bar.toml")
    with Table.open(str(folder / "my-bar.nc"), device=device) as table:
        assert table.device == device and table.attributes["created"].startswith("20")
        with pytest.raises(TableError, match=r"zones 'III': is one text; give a list of names, such as \['III'\]"):
            table.best_row("III")
        with pytest.raises(TableError, match="is one text"):
            table.localized_factor("II")
        assert table.best_row(["III"], level_db=math.inf).zones == (2,)


def test_a_device_changed_in_memory_is_built_with_a_text_that_states_it(folder: Path, tmp_path: Path) -> None:
    device = Device.read(folder / "my-bar.toml")
    heavier = replace(device.actuators[0], mass_kg=9e-3, position_m=0.05)
    thinner, actuators = replace(device.bar, thickness_m=0.7e-3), (heavier, *device.actuators[1:])
    finger, spread = replace(device.finger, spread=2.0), replace(device.spread, stiffness=0.002)
    changed = replace(device, name="other", surface=thinner, actuators=actuators, finger=finger, spread=spread)
    changed = replace(changed, limits=replace(device.limits, amplitude=0.5))
    build_table(changed, tmp_path / "changed.nc", clicks_up_to=0)
    with Table.open(tmp_path / "changed.nc", device=changed) as table:
        assert table.device.actuators[0].position_m == pytest.approx(heavier.position_m, rel=1e-12)
        assert Device.parse(table.device.text, "text").fingerprint == changed.fingerprint != device.fingerprint


def test_a_device_whose_text_cannot_state_a_change_is_refused_before_a_build(folder: Path, tmp_path: Path) -> None:
    device = Device.read(folder / "my-bar.toml")
    longer = replace(device, surface=replace(device.bar, length_m=0.3))
    with pytest.raises(DeviceError, match=r"my-bar: .*zone\[1\]\.stop_m.* changed after it was read; write"):
        build_table(longer, tmp_path / "longer.nc")
    assert not list(tmp_path.iterdir())


def test_a_calibrated_device_is_one_that_a_table_can_be_built_from(folder: Path, tmp_path: Path) -> None:
    device = Device.read(folder / "my-bar.toml")
    found = calibrate(device, read_measurements(folder / "measured.csv", device), ["actuator[1].stiffness"], starts=1)
    new = calibrated_device(found)
    assert new.actuators[0].stiffness_n_per_m == pytest.approx(found.estimates[0].value, rel=1e-9)
    build_table(new, tmp_path / "new.nc", clicks_up_to=0)
    with Table.open(tmp_path / "new.nc", device=new) as table:
        assert table.fingerprint != device.fingerprint


@pytest.mark.parametrize("package", ["engine", "firmware_link", "precompute", "tactable"])
def test_type_checkers_of_users_look_into_the_packages(package: str) -> None:
    assert resources.files(package).joinpath("py.typed").is_file()
