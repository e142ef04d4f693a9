"""Command `quickstart`: from wiring to a felt click by questions; each step is a command, shown before it runs.

Going back undoes a step: the file that its command wrote gets its earlier content, and an emulated board ends.
"""

import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import typer

from base.errors import TactableError
from base.files import replace_file
from engine.touch.sources.hid_discovery import find_digitizers, select_digitizer
from tactable.cli.console import say
from tactable.cli.new import check_answer
from tactable.cli.options import OptionError
from tactable.digitizers.listing import SIMULATED
from tactable.doctor.touch_check import Machine

_BACK, _QUIT, _NO = "back", "quit", "no"
_RUN_S = 10
_BAR = {"length": "279.4mm", "thickness": "0.79mm", "material": "aluminium", "actuators": "45mm,275mm"}


class _BackError(TactableError):
    """The person goes back a step."""


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


@dataclass(frozen=True)
class Step:
    """A step: `ask` gives the words of its command, none where there is nothing to do; `writes`: what it may write."""

    title: str
    ask: Callable[[Answers], list[str]]
    writes: Callable[[Answers], Path | None] = field(default=lambda _: None)


def quickstart() -> None:
    """Go from wiring to a felt click by questions, each step a command.

    Without hardware take every answer that is offered. At each question `back` undoes the step before, and `quit` ends;
    what is written by then stays.
    """
    say(f"Enter takes the answer in brackets; `{_BACK}` undoes the step before, `{_QUIT}` ends.")
    with tempfile.TemporaryDirectory() as folder:
        answers, undo, boards = Answers(Path(folder)), list[Callable[[], None]](), list[subprocess.Popen[str]]()
        try:
            while len(undo) < len(STEPS):
                step = STEPS[len(undo)]
                say(f"\n{len(undo) + 1} of {len(STEPS)}: {step.title}")
                try:
                    words = step.ask(answers)
                    restore = _restoring(step.writes(answers))
                    if not words or _run(words, boards):
                        undo.append(restore)
                    else:
                        restore()
                except _BackError:
                    if undo:
                        undo.pop()()
                        _end(boards if STEPS[len(undo)].ask is _ask_port else [])
        finally:
            _end(boards)
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
        say(f"That ended with exit status {status}: answer again, or `{_BACK}`, or `{_QUIT}`.")
    return status == 0


def _end(boards: list[subprocess.Popen[str]]) -> None:
    while boards:
        with boards.pop() as board:
            board.terminate()


def command_of(words: list[str]) -> list[str]:
    """The command line that runs a command of ours."""
    return [sys.executable, "-m", "tactable", *words]


def _restoring(path: Path | None) -> Callable[[], None]:
    """A function that gives the file its present content again, and removes a file or folder that was made since."""
    if path is None or path.is_dir():
        return lambda: None
    content = path.read_bytes() if path.exists() else None

    def restore() -> None:
        if content is not None:
            with replace_file(path) as partial:
                partial.write_bytes(content)
        elif path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)

    return restore


def _ask(question: str, offered: str, check: Callable[[str], object] = lambda _: None) -> str:
    """The answer to a question, which is asked until `check` takes it."""
    while True:
        answer = str(typer.prompt(question, offered)).strip()
        if answer == _QUIT:
            raise typer.Exit
        if answer == _BACK:
            raise _BackError
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


def _new_table(answers: Answers) -> Path | None:
    """The table, where none is there yet; `build` keeps an earlier one itself, for `tactable rollback`."""
    path = Path(f"{answers.name}.nc")
    return None if path.exists() else path


STEPS = (
    Step("the panel", _ask_panel),
    Step("the bar", _ask_bar, lambda answers: answers.device),
    Step("how the panel lies on the bar", _ask_stroke, lambda answers: answers.device),
    Step("the board", _ask_port),
    Step("the bar as it is", _ask_sensor, lambda answers: answers.calibrated),
    Step("the table", _ask_build, _new_table),
    Step("a click", _ask_run),
)
