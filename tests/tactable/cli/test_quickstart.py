"""What the dialogue promises: every step is a command that is shown, and going back undoes it."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tactable.cli import quickstart
from tactable.cli.main import app

NEW = ["new", "my-bar", "--length", "279.4mm", "--thickness", "0.79mm", "--material", "aluminium"]
OFFERED = "\n"


class Commands(list[list[str]]):
    """The commands that were run; each writes the file that it would, but for those that fail."""

    def __init__(self, *failing: str) -> None:
        super().__init__()
        self.failing = list(failing)

    def run(self, words: list[str]) -> bool:
        self.append(words)
        if words[0] in ("new", "map"):
            Path("my-bar.toml").write_text(words[0], encoding="utf-8")
        if words[0] in self.failing:
            self.failing.remove(words[0])
            return False
        return True

    def names(self) -> list[str]:
        return [words[0] for words in self]


def answer(commands: Commands, lines: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(quickstart, "_run", lambda words, _: commands.run(words))
    monkeypatch.setattr(quickstart, "_list", lambda: None)
    return CliRunner().invoke(app, "quickstart", input=lines).output


def test_offered_answers_lead_to_a_click(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands = Commands()
    said = answer(commands, 20 * OFFERED, monkeypatch, tmp_path)
    assert commands.names() == ["new", "map", "emulate", "build", "run"]
    assert commands[0] == [*NEW, "--actuators", "45mm,275mm"]
    assert commands[-1][:4] == ["run", "my-bar.nc", "--touch", "simulated"]
    assert "7 of 7" in said and "Again: tactable run my-bar.nc" in said


def test_going_back_undoes_the_step_before(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands = Commands()
    # Back from the board: what `map` wrote; then from the stroke: what `new` wrote.
    answer(commands, 7 * OFFERED + "back\nback\nquit\n", monkeypatch, tmp_path)
    assert commands.names() == ["new", "map"]
    assert not (tmp_path / "my-bar.toml").exists()


def test_what_fails_is_asked_again_and_leaves_the_file_as_it_was(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "my-bar.toml").write_text("mine", encoding="utf-8")
    commands = Commands("map")
    answer(commands, 4 * OFFERED + "quit\n", monkeypatch, tmp_path)
    assert commands.names() == ["check", "map"]
    assert (tmp_path / "my-bar.toml").read_text(encoding="utf-8") == "mine"


def test_a_bar_that_was_measured_is_built_as_it_was_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands = Commands()
    answer(commands, 8 * OFFERED + "simulated" + 5 * OFFERED, monkeypatch, tmp_path)
    assert commands.names() == ["new", "map", "emulate", "calibrate", "build", "run"]
    assert commands[4][1] == "my-bar-calibrated/my-bar.toml"


def test_an_answer_that_is_wrong_is_asked_again_at_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands, wrong = Commands(), ("nobody", "", "my bar", "", "30 cmm", "", "1 kg", "", "stel", "", "4,5", "")
    said = answer(commands, "\n".join((*wrong, "", "", "yes", "")) + 6 * OFFERED, monkeypatch, tmp_path)
    assert commands.names() == ["new", "map", "emulate", "build", "run"]
    assert commands[0] == [*NEW, "--actuators", "45mm,275mm"]
    for part in ("no digitizer 'nobody'", "NAME 'my bar'", "--length", "--thickness", "'stel': expected", "'yes': exp"):
        assert part in said


def test_a_bar_that_is_described_anew_keeps_the_old_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "my-bar.toml").write_text("mine", encoding="utf-8")
    commands = Commands()
    answer(commands, 2 * OFFERED + "maybe\nanew\n40cm\n" + 20 * OFFERED, monkeypatch, tmp_path)
    assert commands[0][:4] == ["new", "my-bar", "--length", "40cm"]
    assert (tmp_path / "my-bar.toml.before").read_text(encoding="utf-8") == "mine"
