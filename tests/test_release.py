"""Laws of what is released: nothing that runs is left out, and nothing of tests goes in."""

import subprocess
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).parents[1]
ROOMS = ("base/", "engine/", "firmware_link/", "precompute/", "tactable/")
NOT_INSTALLED = (".md",)
"""Of a room: what only a reader of the checkout needs. Formats of tables travel all the same."""


@pytest.mark.machine(stall_s=None)
def test_a_wheel_has_all_that_rooms_and_tables_hold_and_nothing_of_tests(tmp_path: Path) -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path))
    with zipfile.ZipFile(wheel) as opened:
        names, sizes = opened.namelist(), {Path(each.filename).name: each.file_size for each in opened.infolist()}
    rooms = [name for name in listed if name.startswith(ROOMS) and not name.endswith(NOT_INSTALLED)]
    assert set(rooms) <= set(names)
    tables = [Path(name) for name in listed if name.startswith("tables/")]
    assert {path.name: (ROOT / path).stat().st_size for path in tables}.items() <= sizes.items()
    assert not [name for name in names if name.startswith(("tests/", "docs/", "release/"))]
