"""What a terminal shows while a command works, and that nothing of it reaches a pipe."""

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Column, Table

from tactable.cli import console

WORDS = ("", "-3.2", "18.70 to 18.90 kN/m", "actuator[1].stiffness", "reaches only 11.4 dB", "±8 dB")


def test_brackets_in_names_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """Rich takes what is in brackets for markup, and drops it."""
    names = ["a[bold]b.nc", "zone [I]", "[/red]", "[link=x]y[/link]"]
    for name in names:
        console.OUT.print(name)
    grid = Table(*names)
    grid.add_row(*names)
    console.OUT.print(grid)
    printed = capsys.readouterr().out
    assert all(printed.count(name) == 3 for name in names)


@pytest.mark.parametrize("escape", ["\x1b]0;owned\x07", "\x1b[2J", "\x9b2J", "up\rdown", "\u202egnp.exe"])
def test_names_that_command_a_terminal_are_shown_harmless(monkeypatch: pytest.MonkeyPatch, escape: str) -> None:
    shown = [console.SafeConsole(file=io.StringIO(), force_terminal=True, width=200) for _ in range(2)]
    monkeypatch.setattr(console, "OUT", shown[0])
    monkeypatch.setattr(console, "ERRORS", shown[1])
    console.say(f"touches {escape}")
    grid = Table("digitizer")
    grid.add_row(escape)
    console.OUT.print(grid)
    console.print_error(ValueError(escape))
    console.note(escape)
    with console.shown_work(escape, False):
        pass
    for each in shown:
        assert isinstance(each.file, io.StringIO)
        text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", each.file.getvalue())  # rich's own: styles, and its moving line
        assert not {"\x1b", "\x07", "\x9b", "\u202e"} & set(text)
        assert "\x1b[2J" not in each.file.getvalue() and "up\rdown" not in text


@given(st.lists(st.lists(st.sampled_from(WORDS), min_size=4, max_size=4), min_size=1, max_size=5), st.integers(10, 120))
def test_no_cell_of_a_table_loses_a_word_on_a_terminal_of_any_width(rows: list[list[str]], width: int) -> None:
    grid = Table("zone", "level dB", Column("interval", no_wrap=True), "what it lost", title="a title")
    for row in rows:
        grid.add_row(*row)
    page = io.StringIO()
    shown_at = console.SafeConsole(file=page, width=width)
    shown_at.print(grid)
    shown = page.getvalue()
    assert "…" not in shown and shown_at.width == width
    lines = [line for line in shown.splitlines() if line.startswith("│")]
    for column in range(4):
        cells = " ".join(line.split("│")[1:-1][column].strip() for line in lines).split()
        assert cells == " ".join(row[column] for row in rows).split()
    assert all(len(line) == len(lines[0]) for line in lines)
