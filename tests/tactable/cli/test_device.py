"""The commands `new`, `modes` and `check`: a device file that is made, and what is said of one."""

import shlex
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from engine.device import Device
from engine.device.parts import Plate
from tactable.cli.main import app
from tactable.cli.new import KINDS
from tactable.shipped import find_device, shipped_names
from tests.tactable.cli.in_process import run_here, summary_of

HERE = Path()
run = partial(run_here, HERE)


def test_modes_come_untouched_and_under_fingers_with_a_picture_of_shipped_devices_by_name(tmp_path: Path) -> None:
    assert shipped_names() == ["reference-a", "reference-c", "reference-d", "reference-p", "reference-t"]
    assert [find_device(name).name for name in shipped_names()] == shipped_names()
    picture = tmp_path / "modes.svg"
    found = summary_of(HERE, "modes", "reference-a", "--finger", "I,120 mm", "--up-to", "400 Hz", "-o", str(picture))
    assert found["finger_m"] == pytest.approx([0.02794, 0.12])
    frequencies = [mode["frequency_hz"] for mode in found["untouched"]]
    assert frequencies == sorted(frequencies) and frequencies[-1] <= 400 and len(frequencies) == 6
    assert found["with_finger"][1]["damping_ratio"] > found["untouched"][1]["damping_ratio"]
    assert picture.stat().st_size > 10_000
    done = run("modes", "reference-a", "--finger", "III", "-o", str(tmp_path / "modes.csv"))
    assert done.returncode == 0 and f"{frequencies[0]:.2f} Hz" in done.stdout
    assert "Computed, not measured" in done.stdout
    assert (tmp_path / "modes.csv").read_text(encoding="utf-8").startswith("position (mm),mode 1 untouched")


def test_a_check_says_what_drivers_and_electrodes_make_of_a_command(tmp_path: Path) -> None:
    points = 'transfer = [["60 Hz", "99 %", "-8 deg"], ["150 Hz", "93 %", "-20 deg"], ["300 Hz", "79 %", "-38 deg"]]'
    text = find_device("reference-a").text.replace('name = "left"', f'name = "left"\n{points}')
    alone = '[actuator.electrodes]\nnumber = 1\nbias = "50 %"\n'
    opposed = '[actuator.electrodes]\nnumber = 2\nbias = "50 %"\n'
    text = text.replace('name = "right"', 'name = "right"\nclamp = "20 mm"')
    text = text.replace('[[actuator]]\nname = "right"', f'{alone}\n[[actuator]]\nname = "right"')
    path = tmp_path / "driven.toml"
    path.write_text(text.replace("[zones]", f"{opposed}\n[zones]"), encoding="utf-8")
    done = run("check", str(path))
    for part in ("transfer function of left: 3 points", "electrodes of left: one electrode", "-12.0 dB"):
        assert part in done.stdout
    assert "bolts of right clamp the bar from 263 to 279.4 mm: it does not bend there" in done.stdout
    assert "electrodes of right: two electrodes 180 deg apart" in done.stdout and "the force is linear" in done.stdout
    assert summary_of(HERE, "check", str(path))["electrodes"]["left"]["second_harmonic"] == 0.25


def test_a_check_says_what_is_estimated_and_what_follows() -> None:
    found = summary_of(HERE, "check", "reference-a")
    device = find_device("reference-a")
    assert found["estimated"] == list(device.estimated_values) and len(found["estimated"]) == 15
    assert list(found["greatest_level_db"]) == ["I", "II", "III", "IV", "V"]
    assert found["levels_out_of_reach"] == []
    done = run("check", "reference-a")
    for part in (
        "valid; reference-a",
        "15 values are ESTIMATES",
        "most in actuator[2].mass",
        "band of left: 60 to 300",
        "first modes",
    ):
        assert part in done.stdout


def test_a_check_names_the_threshold_curve_and_the_finger(tmp_path: Path) -> None:
    own, other = (summary_of(HERE, "check", "reference-a", "--threshold", name) for name in ("oh-choi-2019", "android"))
    assert (own["threshold"]["name"], own["threshold"]["measured_hz"]) == ("oh-choi-2019", [40.0, 250.0])
    assert (other["threshold"]["name"], other["threshold"]["measured_hz"]) == ("android", None)
    for zone, level_db in own["greatest_level_db"].items():
        assert 1 < level_db - other["greatest_level_db"][zone] < 9  # as far as the curves are apart from 60 to 300 Hz
    assert own["finger"]["misfit"] is None and own["finger"]["mass_kg"] == 1e-4
    text = find_device("reference-a").text.replace(
        'mass = "0.1 g"\ndamping', "impedance = [[60, 1, -3], [200, 1.2, -0.6], [300, 0.9, -0.4]]\ndamping"
    )
    text = text.replace('damping = "1 N*s/m"\nstiffness = "1 kN/m"\n', "")
    (tmp_path / "measured.toml").write_text(text, encoding="utf-8")
    found = summary_of(HERE, "check", str(tmp_path / "measured.toml"))["finger"]
    assert found["measured_points"] == 3 and found["measured_hz"] == [60, 300] and 0 < found["misfit"] < 1
    done = run("check", str(tmp_path / "measured.toml"))
    assert "fitted to 3 measured points from 60 to 300 Hz, off by" in done.stdout
    assert run("check", "reference-a", "--threshold", "loud").returncode != 0


def test_a_level_that_no_drive_reaches_is_named_with_its_zones(tmp_path: Path) -> None:
    text = find_device("reference-a").text.replace('"10 dB", "20 dB", "30 dB"', '"20 dB", "43 dB"')
    (tmp_path / "loud.toml").write_text(text, encoding="utf-8")
    found = summary_of(HERE, "check", str(tmp_path / "loud.toml"))
    weak = [name for name, most_db in found["greatest_level_db"].items() if most_db < 43]
    assert weak and found["levels_out_of_reach"] == [{"level_db": 43.0, "zones": weak}]
    assert f"43 dB is out of reach in {', '.join(weak)}" in run("check", str(tmp_path / "loud.toml")).stdout


ALWAYS = ("--length", "300mm", "--thickness", "1 mm", "--actuators", "40mm,87 %")
EVERY = shlex.split("--width '20 mm' --material steel --zones 4")


def run_new(path: Path, *words: str) -> Result:
    return CliRunner().invoke(app, ["new", "my-bar", *words, "-o", str(path)])


def test_what_is_given_is_in_the_file_and_the_rest_is_an_estimate(tmp_path: Path) -> None:
    done = run_new(tmp_path / "few.toml", *ALWAYS)
    assert done.exit_code == 0, done.output
    few = Device.read(tmp_path / "few.toml")
    assert (few.name, few.bar.length_m, few.bar.thickness_m) == ("my-bar", 0.3, 1e-3)
    assert [actuator.position_m for actuator in few.actuators] == pytest.approx([0.04, 0.261])
    assert {"bar.width", "bar.youngs_modulus", "bar.density", "actuator[2].band"} <= set(few.estimated_values)
    assert not {"bar.length", "bar.thickness"} & set(few.estimated_values)
    every = tmp_path / "every.toml"
    assert run_new(every, *ALWAYS, *EVERY).exit_code == 0
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
    done = run_new(tmp_path / "plate.toml", *shlex.split(words))
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
    assert run_new(tmp_path / "bar.toml", *ALWAYS, "--kind", kind).exit_code == 0
    device = Device.read(tmp_path / "bar.toml")
    estimates = {name.partition("].")[2] for name in device.estimated_values if name.startswith("actuator[1]")}
    assert estimates == {*KINDS[kind], "band"}
    assert CliRunner().invoke(app, ["check", str(tmp_path / "bar.toml")]).exit_code == 0
