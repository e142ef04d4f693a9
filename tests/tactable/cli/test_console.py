"""What a terminal shows while a command works, and that nothing of it reaches a pipe."""

import io

import pytest
from rich.console import Console

from tactable.cli import console


@pytest.mark.parametrize(("is_terminal", "is_hidden"), [(True, False), (True, True), (False, False)])
def test_work_is_shown_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch, is_terminal: bool, is_hidden: bool) -> None:
    shown = Console(file=io.StringIO(), force_terminal=is_terminal, width=100)
    monkeypatch.setattr(console, "ERRORS", shown)
    with console.shown_work("computing the click", is_hidden):
        pass
    assert isinstance(shown.file, io.StringIO)
    assert ("computing the click" in shown.file.getvalue()) == (is_terminal and not is_hidden)
