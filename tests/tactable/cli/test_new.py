"""The command `new`: a device file that is read again, in which just what was not given is an estimate."""

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from engine.device import Device
from tactable.cli.main import app
from tactable.cli.new import MATERIALS

ALWAYS = ("--length", "300mm", "--thickness", "1 mm", "--actuators", "40mm,87 %")
EVERY = (
    *("--width", "20 mm", "--material", "steel", "--stiffness", "20 kN/m", "--damping", "0.1 N*s/m", "--mass", "8 g"),
    *("--full-scale", "1 um", "--band", "50 Hz,400 Hz", "--zones", "4"),
)


def run(path: Path, *words: str) -> Result:
    return CliRunner().invoke(app, ["new", "my-bar", *words, "-o", str(path)])


def test_what_is_given_is_in_the_file_and_the_rest_is_an_estimate(tmp_path: Path) -> None:
    done = run(tmp_path / "few.toml", *ALWAYS)
    assert done.exit_code == 0, done.output
    few = Device.read(tmp_path / "few.toml")
    assert (few.name, few.bar.length_m, few.bar.thickness_m) == ("my-bar", 0.3, 1e-3)
    assert [actuator.position_m for actuator in few.actuators] == pytest.approx([0.04, 0.261])
    assert {"bar.width", "bar.youngs_modulus", "bar.density", "actuator[2].band"} <= set(few.estimated_values)
    assert not {"bar.length", "bar.thickness"} & set(few.estimated_values)
    every = tmp_path / "every.toml"
    assert run(every, *ALWAYS, *EVERY).exit_code == 0
    device = Device.read(every)
    kinds = {name.split(".")[0] for name in device.estimated_values}
    assert kinds == {"bar", "finger", "spread"}
    assert [name for name in device.estimated_values if name.startswith("bar")] == [
        "bar.mass_damping",
        "bar.stiffness_damping",
    ]
    assert (device.bar.youngs_modulus_pa, device.bar.density_kg_per_m3) == (200e9, 7850.0)
    assert device.actuators[0].band_hz == (50.0, 400.0) and len(device.zones) == 4


@pytest.mark.parametrize("material", MATERIALS)
def test_every_material_makes_a_bar(material: str, tmp_path: Path) -> None:
    assert run(tmp_path / "bar.toml", *ALWAYS, "--material", material).exit_code == 0
    bar = Device.read(tmp_path / "bar.toml").bar
    assert 1e9 < bar.youngs_modulus_pa < 300e9 and 1000 < bar.density_kg_per_m3 < 9000


def test_a_given_modulus_takes_the_place_of_the_materials(tmp_path: Path) -> None:
    run(tmp_path / "bar.toml", *ALWAYS, "--material", "glass", "--youngs-modulus", "69GPa")
    bar = Device.read(tmp_path / "bar.toml").bar
    assert (bar.youngs_modulus_pa, bar.density_kg_per_m3) == (69e9, 2500.0)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--length", "300g"), "--length: '300g' is a mass"),
        (("--material", "cheese"), "--material 'cheese': expected one of aluminium"),
        (("--actuators", ","), "--actuators names no position"),
        (("--actuators", "400mm"), "is off the bar, which is 300 mm long"),
        (("--actuators", "some%"), "--actuators 'some%': expected a length or a percentage"),
        (("--band", "60Hz"), "--band '60Hz': expected two frequencies"),
        (("--band", "300Hz,60Hz"), "--band '300Hz,60Hz': expected the lower frequency first"),
    ],
)
def test_what_is_no_bar_is_refused_and_leaves_no_file(words: tuple[str, ...], told: str, tmp_path: Path) -> None:
    done = run(tmp_path / "bar.toml", *ALWAYS, *words)
    assert done.exit_code and told in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "bar.toml"
    path.write_text("mine", encoding="utf-8")
    done = run(path, *ALWAYS)
    assert "exists already and is not overwritten" in str(done.exception) and path.read_text() == "mine"
    nowhere = run(tmp_path / "no" / "bar.toml", *ALWAYS)
    assert "cannot be written there: No such file" in str(nowhere.exception)


def test_a_device_file_is_not_written_under_the_name_of_another_kind(tmp_path: Path) -> None:
    for name in ("bar.nc", "bar"):
        done = run(tmp_path / name, *ALWAYS)
        assert done.exit_code and f"a device file is TOML; name it {tmp_path / 'bar.toml'}" in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path) -> None:
    for name in ("a/b", "", 'a"b', "x" * 65):
        done = CliRunner().invoke(app, ["new", name, *ALWAYS, "-o", str(tmp_path / "bar.toml")])
        assert "expected letters, digits" in str(done.exception), name
