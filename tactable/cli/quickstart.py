"""Command `quickstart`: from wiring to a felt click by questions; each step is a command, shown before it runs."""

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import typer

from base.errors import TactableError
from engine.touch.sources.hid_discovery import find_digitizers, select_digitizer
from tactable.cli.console import say
from tactable.cli.new import check_answer
from tactable.cli.options import OptionError
from tactable.digitizers.listing import SIMULATED
from tactable.doctor.touch_check import Machine

_QUIT, _NO = "quit", "no"
_RUN_S = 10
_BAR = {"length": "279.4mm", "thickness": "0.79mm", "material": "aluminium", "actuators": "45mm,275mm"}


@dataclass
class Answers:
    """What the person said so far; folder: where an emulated board has its name."""

    folder: Path
    panel: str = SIMULATED
    name: str = "my-bar"
    port: str = SIMULATED
    sensor: str = _NO
    bar: dict[str, str] = field(default_factory=_BAR.copy)

    @property
    def device(self) -> Path:
        """The device file as it was described."""
        return Path(f"{self.name}.toml")

    @property
    def calibrated(self) -> Path:
        """The folder of the bar as it was measured."""
        return Path(f"{self.name}-calibrated")

    @property
    def board(self) -> str:
        """The port that a run writes to."""
        return str(self.folder / "board") if self.port == SIMULATED else self.port


def quickstart() -> None:
    """Go from wiring to a felt click by questions, each step a command.

    Without hardware take every answer that is offered. `quit` ends at each question; what is written by then stays.
    """
    say(f"Enter takes the answer in brackets, `{_QUIT}` ends.")
    with tempfile.TemporaryDirectory() as folder:
        answers, boards = Answers(Path(folder)), list[subprocess.Popen[str]]()
        try:
            for number, (title, ask) in enumerate(STEPS.items(), 1):
                say(f"\n{number} of {len(STEPS)}: {title}")
                while (words := ask(answers)) and not _run(words, boards):
                    pass
        finally:
            for board in boards:
                with board:
                    board.terminate()
    port = answers.port
    if port == SIMULATED:
        port = "board"
        say(f"\nAgain, beside it: tactable emulate --device {answers.device} --link {port}")
    say(f"\nAgain: tactable run {answers.name}.nc --touch {answers.panel} --port {port}; docs/first-hour.md goes on")


def _run(words: list[str], boards: list[subprocess.Popen[str]]) -> bool:
    """Show a command and run it; whether it did what it should. An emulated board runs on."""
    say(f"$ tactable {shlex.join(words)}")
    if words[0] == "emulate":
        boards.append(subprocess.Popen(command_of(words), stdout=subprocess.PIPE, text=True))
        assert boards[-1].stdout is not None
        say(boards[-1].stdout.readline().rstrip())
        return boards[-1].poll() is None
    status = subprocess.run(command_of(words), check=False).returncode
    if status:
        say(f"That ended with exit status {status}: answer again, or `{_QUIT}`.")
    return status == 0


def command_of(words: list[str]) -> list[str]:
    """The command line that runs a command of ours."""
    return [sys.executable, "-m", "tactable", *words]


def _ask(question: str, offered: str, check: Callable[[str], object] = lambda _: None) -> str:
    """The answer to a question, which is asked until `check` takes it."""
    while True:
        answer = str(typer.prompt(question, offered)).strip()
        if answer == _QUIT:
            raise typer.Exit
        try:
            check(answer)
        except TactableError as error:
            say(str(error))
        else:
            return answer


def _one_of(*expected: str) -> Callable[[str], None]:
    def check(answer: str) -> None:
        if answer not in expected:
            raise OptionError(f"{answer!r}: expected {' or '.join(expected)}")

    return check


def _list() -> None:
    subprocess.run(command_of(["list"]), check=False)


def _find_panel(name: str) -> None:
    """Look for a panel as `map` will; one of the input layer is a path."""
    if name != SIMULATED and not name.startswith("/dev/input/"):
        select_digitizer(name, find_digitizers(Machine().hid()))


def _ask_panel(answers: Answers) -> list[str]:
    _list()
    answers.panel = _ask("The panel, as listed under `choose it by`", answers.panel, _find_panel)
    return []


def _ask_bar(answers: Answers) -> list[str]:
    answers.name = _ask("A name for your bar", answers.name, partial(check_answer, "name"))
    if answers.device.exists():
        question = f"{answers.device} is there: keep it, or describe the bar anew"
        if _ask(question, "keep", _one_of("keep", "anew")) == "keep":
            return ["check", str(answers.device)]
    for key, offered in answers.bar.items():
        answers.bar[key] = _ask(f"Its {key}", offered, partial(check_answer, key))
    if answers.device.exists():
        kept = answers.device.with_suffix(".toml.before")
        answers.device.replace(kept)
        say(f"{answers.device} is kept as {kept}")
    return ["new", answers.name, *(word for key, text in answers.bar.items() for word in (f"--{key}", text))]


def _ask_stroke(answers: Answers) -> list[str]:
    _ask("Draw one finger along the bar, from its start to its end, once you have pressed Enter", "go on")
    return ["map", answers.panel, "--device", str(answers.device), "--write"]


def _ask_port(answers: Answers) -> list[str]:
    answers.port = _ask("The board's port, as listed; its amplifier is off", answers.port)
    if answers.port == SIMULATED:
        return ["emulate", "--device", str(answers.device), "--link", answers.board]
    device = ["play", str(answers.device), "--port", answers.port]
    return [*device, "--frequency", "150", "--amplitude", "5 %", "--for", "1s"]


def _ask_sensor(answers: Answers) -> list[str]:
    if answers.port == SIMULATED:
        question, check = f"Measure the bar as it is? {SIMULATED}, as the board is, or no", _one_of(SIMULATED, _NO)
    else:
        question, check = "Measure the bar as it is? The sensor, as `tactable measure --help` names it, or no", None
    answers.sensor = _ask(question, answers.sensor, check or (lambda _: None))
    if answers.sensor == _NO:
        return []
    words = ["calibrate", str(answers.device), f"{answers.name}-measured.csv", "--measure"]
    return [*words, "--port", answers.port, "--sensor", answers.sensor, "-o", str(answers.calibrated)]


def _ask_build(answers: Answers) -> list[str]:
    device = answers.device if answers.sensor == _NO else answers.calibrated / answers.device
    fingers = _ask("Clicks ahead for placements of so many fingers (1: a minute at first)", "1")
    return ["build", str(device), "--clicks-up-to", fingers]


def _ask_run(answers: Answers) -> list[str]:
    seconds = _ask("Switch the supply on (docs/safety.md), then touch the bar, for so many seconds", str(_RUN_S))
    return ["run", f"{answers.name}.nc", "--touch", answers.panel, "--port", answers.board, "--for", seconds]


STEPS: Mapping[str, Callable[[Answers], list[str]]] = {
    "the panel": _ask_panel,
    "the bar": _ask_bar,
    "how the panel lies on the bar": _ask_stroke,
    "the board": _ask_port,
    "the bar as it is": _ask_sensor,
    "the table": _ask_build,
    "a click": _ask_run,
}
"""The steps by their titles; each gives the words of its command, none where there is nothing to do."""
