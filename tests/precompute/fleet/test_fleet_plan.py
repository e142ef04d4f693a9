"""Laws of planning: folder and manifest name the same units, and what is wrong in them is refused by name."""

import re
from pathlib import Path

import pytest

from engine.device import Device, DeviceError
from engine.device.named_files import text_with_values
from precompute.fleet.units import FleetError, Unit, plan_fleet
from tests.precompute.fleet.small_fleet import small_text

PAGE = (Path(__file__).parents[3] / "docs" / "fleet.md").read_text(encoding="utf-8")


def written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def test_a_subfolder_is_a_unit(tmp_path: Path) -> None:
    for name in (
        "b/device.toml",
        "b/other.toml",
        "a/bar.toml",
        "a/measurements.uff",
        "a/notes.csv",
        ".hidden/device.toml",
    ):
        written(tmp_path / name, "")
    written(tmp_path / "loose.toml", "")
    (tmp_path / "empty").mkdir()
    assert plan_fleet(tmp_path) == [
        Unit("a", tmp_path / "a/bar.toml", tmp_path / "a/measurements.uff"),
        Unit("b", tmp_path / "b/device.toml"),
        Unit("empty", tmp_path / "empty/device.toml"),
    ]


def test_a_row_of_a_manifest_is_a_unit(tmp_path: Path) -> None:
    text = """name,device,measurements,actuator[1].stiffness, zones.count
        4000,bars/4000.toml,data/4000.csv,,

        4001,/elsewhere/4001.toml,,19 kN/m,4
    """
    expected = [
        Unit("4000", tmp_path / "bars/4000.toml", tmp_path / "data/4000.csv"),
        Unit("4001", Path("/elsewhere/4001.toml"), None, {"actuator[1].stiffness": "19 kN/m", "zones.count": "4"}),
    ]
    assert plan_fleet(written(tmp_path / "fleet.csv", text)) == expected


@pytest.mark.parametrize(
    ("name", "text", "parts"),
    [
        ("f.csv", "name,device\na,b\na,c\n", ("'a'", "two units")),
        ("f.csv", "name,device\n..,b\n", ("'..'", "folder")),
        ("f.csv", "", ("no column 'name'",)),
        ("f.csv", "name,device\na,b,c\n", ("line 2", "3 cells", "2")),
        ("f.csv", "name,device\na,\n", ("line 2", "device")),
        ("f.csv", "name,device\n", ("no unit",)),
        ("f.yaml", "", ("ends in .csv",)),
    ],
)
def test_what_is_wrong_is_refused_by_name(tmp_path: Path, name: str, text: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(FleetError) as error:
        plan_fleet(written(tmp_path / name, text))
    for part in (name, *parts):
        assert part in str(error.value)


def test_a_folder_without_folders_is_no_fleet(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="no unit"):
        plan_fleet(tmp_path)


def test_values_are_set_and_the_rest_of_the_text_stays() -> None:
    text = small_text()
    values = {
        "bar.thickness": "0.8 mm",
        "actuator[2].mass": "10 g",
        "actuator.damping": "0.1 N*s/m",
        "finger.mass": "0.2 g",
        "name": "other",
        "zones.count": "3",
    }
    changed = text_with_values(text, values, "bar")
    device = Device.parse(changed, "bar")
    assert [actuator.mass_kg for actuator in device.actuators] == pytest.approx([0.0095, 0.01])
    assert [actuator.damping_n_s_per_m for actuator in device.actuators] == [0.1, 0.1]
    assert device.bar.thickness_m == pytest.approx(0.8e-3)
    assert (device.name, len(device.zones)) == ("other", 3)
    lines, changed_lines = text.splitlines(), changed.splitlines()
    assert sum(a != b for a, b in zip(lines, changed_lines, strict=True)) == len(values) + 1  # at each actuator


@pytest.mark.parametrize(
    "key", ["actuator[3].mass", "actuator[0].mass", "bar[1].width", "nowhere.mass", "bar.", "a.b.c", ""]
)
def test_a_place_that_the_description_has_not_is_refused(key: str) -> None:
    with pytest.raises(DeviceError, match="bar: "):
        text_with_values(small_text(), {key: "1 g"}, "bar")


def test_the_manifest_of_the_page_is_one(tmp_path: Path) -> None:
    path = tmp_path / "line.csv"
    path.write_text(re.findall(r"```csv[^\n]*\n(.*?)```", PAGE, re.DOTALL)[0], encoding="utf-8")
    assert plan_fleet(path) == [
        Unit("4000", tmp_path / "bars/4000.toml", tmp_path / "measured/4000.csv"),
        Unit("4001", tmp_path / "bars/nominal.toml", None, {"actuator[1].stiffness": "18.2 kN/m"}),
    ]


@pytest.mark.parametrize("figure", re.findall(r"`(\w+_(?:db|s)|out_of_reach|clicks)`", PAGE))
def test_every_figure_of_the_page_is_one_of_the_summary(figure: str) -> None:
    code = (Path(__file__).parents[3] / "precompute" / "fleet" / "fleet_run.py").read_text(encoding="utf-8")
    assert f'"{figure}":' in code
