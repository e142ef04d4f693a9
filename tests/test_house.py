"""The house rules, and commands in the README that do what they say."""

import re
from pathlib import Path

import pytest

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
