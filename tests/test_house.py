"""The house rules, what is released, and the README's commands and the examples, which run as they stand."""

import re
import runpy
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hatchling.builders.wheel import WheelBuilder

import tactable
from base.points import is_within
from tactable import Device, build_table, find_device
from tactable.control.client import Client, hello
from tactable.control.requests import DefineEffect, Region, read_request
from tactable.shipped import named_effects
from tests.documents import Command, check_command, read_blocks, read_commands
from tests.small_device import small_text
from tests.tactable.cli.in_process import run_here

ROOT = Path(__file__).parents[1]


def test_tables_is_no_package() -> None:
    assert not list((ROOT / "tables").rglob("*.py"))


def readme_commands() -> list[Command]:
    """The lines of the README's shell blocks that call the installed command."""
    blocks = [block for block in read_blocks(ROOT / "README.md") if block.language == "sh"]
    return [command for block in blocks for command in read_commands(block) if command.words[0] == "tactable"]


def test_the_readme_begins_with_its_two_commands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/tactable demo" in text
    assert ".venv/bin/pip install -e '.[test]' && .venv/bin/pytest" in text
    assert (ROOT / re.findall(r"!\[.*?\]\((.*?)\)", text)[0]).is_file()


def test_every_command_of_the_readme_exists_with_its_options() -> None:
    commands = readme_commands()
    assert len(commands) >= 4
    for command in commands:
        check_command(command)


@pytest.mark.long
def test_the_commands_of_the_readme_run_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for command in readme_commands():
        words = command.words
        if words[1] == "build":
            words += ["--clicks-up-to", "0"]  # clicks take minutes and nothing new
        done = run_here(tmp_path, *words[1:])
        assert done.returncode == 0, f"{command.line}\n{done.stdout}{done.stderr}"


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


FOLDER = Path(__file__).parents[1] / "examples"


def run(monkeypatch: pytest.MonkeyPatch, name: str, *words: str) -> dict[str, Any]:
    monkeypatch.chdir(FOLDER.parent)
    monkeypatch.setattr(sys, "argv", [name, *words])
    return runpy.run_path(str(FOLDER / f"{name}.py"))


def test_a_finger_damps_the_modes_of_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    found = run(monkeypatch, "own_bar")
    assert float(found["held"].decay_time[0]) < 0.1 * float(found["free"].decay_time[0])
    assert found["loudest"].dims == ("frequency", "actuator")


@pytest.mark.long
def test_a_drive_and_a_click_need_no_table_and_wrong_words_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    found = run(monkeypatch, "without_a_table")
    drive, device = found["drive"], found["device"]
    assert drive.achieved and drive.contrast_db == pytest.approx(drive.level_db[0] - drive.level_db[1])
    assert found["click"].felt.low_db != found["again"].felt.low_db
    with pytest.raises(tactable.TactableError, match=r"level_db='loud': expected a number"):
        tactable.solve_click(device, felt=["35 mm"], level_db="loud")  # type: ignore[arg-type]
    with pytest.raises(tactable.TactableError, match=r"felt=0.06: is one position; give a list, such as \[0.06\]"):
        tactable.solve_drive(device, felt=0.06)  # type: ignore[arg-type]


@pytest.mark.long
def test_the_best_row_reaches_its_level_with_a_factor_of_the_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    found = run(monkeypatch, "best_row")
    assert found["best"].achieved and 0.5 < found["best"].localized_factor <= np.nanmax(found["factor"])


@pytest.mark.long
def test_a_fit_finds_the_stiffness_of_the_measured_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    found = run(monkeypatch, "measured_bar")
    assert found["calibrated"].actuators[0].stiffness_n_per_m == pytest.approx(20.5e3, rel=2e-3)


@pytest.mark.long
def test_a_click_promises_the_level_that_was_asked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    build_table(Device.parse(small_text(), "small"), tmp_path / "bar.nc", clicks_up_to=1)
    found = run(monkeypatch, "click_under_a_finger", str(tmp_path / "bar.nc"), "35 mm")
    assert found["click"].achieved and float(found["found"].felt_level.sel(spread="5 %")) == pytest.approx(20, abs=0.1)


class RunOnAPlate(Client):
    """A run that reads each message as a real one, for the plate that is shipped, and has no events."""

    def __init__(self, *, name: str) -> None:
        self.device, self.effects, self.regions = find_device("reference-p"), dict(named_effects()), list[Region]()
        self.ask(hello(name, None))

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        request = read_request(message, self.device, self.effects, 0)
        if isinstance(request, DefineEffect):
            self.effects[request.effect.name] = request.effect
        self.regions += [request] if isinstance(request, Region) else []
        return {"fingers": []}

    def events(self, timeout_s: float | None = None) -> Iterator[dict[str, Any]]:  # noqa: ARG002
        return iter(())

    def close(self) -> None:
        pass


def test_controls_lie_on_the_plate_apart_and_sliders_count_one_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tactable, "connect", RunOnAPlate)
    regions = {region.name: region for region in run(monkeypatch, "controls_on_a_plate")["run"].regions}
    assert [regions[name].rules[0].along for name in ("Pan", "Volume")] == [1, 1j]
    rectangles_m = [region.region_m for region in regions.values() if region.region_m is not None]
    for start_m, stop_m in rectangles_m:
        middle_m = (start_m + stop_m) / 2
        assert sum(is_within(middle_m - first_m, last_m - first_m) for first_m, last_m in rectangles_m) == 1
