"""The walk-through of fleets: its manifest is what the command reads, and its figures are those of the summary."""

import re
from pathlib import Path

import pytest

from precompute.fleet.fleet_plan import plan_fleet
from precompute.fleet.units import Unit

PAGE = (Path(__file__).parents[3] / "docs" / "fleet.md").read_text(encoding="utf-8")


def test_the_manifest_of_the_page_is_one(tmp_path: Path) -> None:
    """Its study is run by test_docs.py."""
    path = tmp_path / "line.csv"
    path.write_text(re.findall(r"```csv[^\n]*\n(.*?)```", PAGE, re.DOTALL)[0], encoding="utf-8")
    assert plan_fleet(path) == [
        Unit("4000", tmp_path / "bars/4000.toml", tmp_path / "measured/4000.csv"),
        Unit("4001", tmp_path / "bars/nominal.toml", None, {"actuator[1].stiffness": "18.2 kN/m"}),
    ]


@pytest.mark.parametrize("figure", re.findall(r"`(\w+_(?:db|s)|out_of_reach|clicks)`", PAGE))
def test_every_figure_of_the_page_is_one_of_the_summary(figure: str) -> None:
    code = (Path(__file__).parents[3] / "precompute" / "fleet" / "figures.py").read_text(encoding="utf-8")
    assert f'"{figure}":' in code
