"""The command `new`: a device file that is read again, in which just what was not given is an estimate."""

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from engine.device import Device
from engine.device.parts import Plate
from tactable.cli.main import app
from tactable.cli.new import KINDS

ALWAYS = ("--length", "300mm", "--thickness", "1 mm", "--actuators", "40mm,87 %")
EVERY = shlex.split("--width '20 mm' --material steel --zones 4")


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
    assert [name for name in device.estimated_values if name.startswith("bar")] == [
        "bar.mass_damping",
        "bar.stiffness_damping",
    ]
    assert (device.bar.youngs_modulus_pa, device.bar.density_kg_per_m3) == (200e9, 7850.0)
    assert len(device.zones) == 4


def test_points_of_actuators_make_a_plate_whose_zones_are_as_square_as_they_can_be(tmp_path: Path) -> None:
    words = (
        "--length 250mm --width 120mm --thickness 1.1mm --material glass --actuators '30x25 mm,90% x 80 %' --zones 8"
    )
    done = run(tmp_path / "plate.toml", *shlex.split(words))
    assert done.exit_code == 0, done.output
    device = Device.read(tmp_path / "plate.toml")
    assert device.surface.corner_m == 0.25 + 0.12j and isinstance(device.surface, Plate)
    assert [actuator.position_m for actuator in device.actuators] == pytest.approx([0.03 + 0.025j, 0.225 + 0.096j])
    assert device.surface.poissons_ratio == 0.23
    assert [zone.stop_m - zone.start_m for zone in device.zones] == [pytest.approx(0.0625 + 0.06j)] * 8
    assert {name for name in device.estimated_values if name.startswith("plate")} == {
        "plate.mass_damping",
        "plate.stiffness_damping",
    }


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_usual_of_a_kind_of_actuator_is_an_estimate(kind: str, tmp_path: Path) -> None:
    assert run(tmp_path / "bar.toml", *ALWAYS, "--kind", kind).exit_code == 0
    device = Device.read(tmp_path / "bar.toml")
    estimates = {name.partition("].")[2] for name in device.estimated_values if name.startswith("actuator[1]")}
    assert estimates == {*KINDS[kind], "band"}
    assert CliRunner().invoke(app, ["check", str(tmp_path / "bar.toml")]).exit_code == 0
