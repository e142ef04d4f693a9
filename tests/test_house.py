"""The house rules, commands in the README that do what they say, and what is released."""

import re
import subprocess
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

from tests.documents import Command, check_command, read_blocks, read_commands
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
