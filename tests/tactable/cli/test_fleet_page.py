"""The walk-through of fleets: its manifest and its study are what the command reads."""

import re
from pathlib import Path

import pytest

from precompute.fleet.fleet_plan import plan_fleet
from precompute.fleet.units import Unit

PAGE = (Path(__file__).parents[3] / "docs" / "fleet.md").read_text(encoding="utf-8")


def units(folder: Path, kind: str, index: int) -> list[Unit]:
    path = folder / f"fleet.{kind}"
    path.write_text(re.findall(rf"```{kind}[^\n]*\n(.*?)```", PAGE, re.DOTALL)[index], encoding="utf-8")
    return plan_fleet(path)


def test_the_manifest_of_the_page_is_one(tmp_path: Path) -> None:
    expected = [
        Unit("4000", tmp_path / "bars/4000.toml", tmp_path / "measured/4000.csv"),
        Unit("4001", tmp_path / "bars/nominal.toml", None, {"actuator[1].stiffness": "18.2 kN/m"}),
    ]
    assert units(tmp_path, "csv", 0) == expected


def test_the_study_of_the_page_is_one(tmp_path: Path) -> None:
    found = units(tmp_path, "toml", 0)
    assert len(found) == 4
    assert {unit.evaluated_table for unit in found} == {tmp_path / "my-bar.nc"}
    assert set(found[0].values) == {"bar.thickness", "actuator.stiffness", "finger.mass"}


@pytest.mark.parametrize("figure", re.findall(r"`(\w+_(?:db|s)|out_of_reach|clicks)`", PAGE))
def test_every_figure_of_the_page_is_one_of_the_summary(figure: str) -> None:
    code = (Path(__file__).parents[3] / "precompute" / "fleet" / "figures.py").read_text(encoding="utf-8")
    assert f'"{figure}":' in code
