"""How the command line starts, importing little, and ends: a line and a status for what it cannot do; how it prints."""

import errno
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from importlib.metadata import version
from inspect import getdoc
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Column
from rich.table import Table as Grid
from typer.testing import CliRunner

from base.errors import TactableError
from engine.table import Table
from precompute.parallel.pool import WorkerError
from tactable.cli import console, start, touch
from tactable.cli.main import COMMANDS, app, load_command, main
from tests.precompute.builder.test_table_build import SMALL
from tests.tactable.cli.in_process import run_here
from tests.tools.processes import started

ROOT = Path(__file__).parents[3]
ROOMS = ("engine", "firmware_link", "precompute", "tactable")
UNDER_ANOTHER_ERROR = {
    "QuantityError": "becomes DeviceError or OptionError",
    "PageMessageError": "answers a browser",
    "_FlawError": "becomes TableError",
}


def bases_of_errors() -> dict[str, set[str]]:
    """Names of the bases of every class of the four rooms whose name ends in Error."""
    found: dict[str, set[str]] = {}
    for path in (path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        for name, bases in re.findall(r"^ *class (\w*Error)\b(?:\(([^)]*)\))?", path.read_text(encoding="utf-8"), re.M):
            found[name] = {base for base in re.split(r"[,\s]+", bases) if base.isidentifier()}
    return found


def test_every_error_derives_from_the_root() -> None:
    bases = bases_of_errors()

    def is_ours(name: str) -> bool:
        return name == "TactableError" or any(is_ours(base) for base in bases.get(name, ()))

    strangers = {name for name, own in bases.items() if own and not is_ours(name)}
    assert strangers == set(UNDER_ANOTHER_ERROR)


def end_of(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> object:
    """Exit status of a command that raises `error`."""

    def fail(_machine: object) -> None:
        raise error

    monkeypatch.setattr(touch, "find_devices", fail)
    monkeypatch.setattr(sys, "argv", ["tactable", "list"])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        *[(kind("no [bar]: mend it"), 1, "no [bar]: mend it\n") for kind in (TactableError, WorkerError)],
        (OSError("no [bar]: mend it"), 1, "no [bar]: mend it\n"),
        (FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "gone.csv"), 1, "gone.csv: No such file"),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), 1, "No space left on device: where the output goes"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_an_error_is_one_line_and_status_one_and_ctrl_c_is_quiet(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: BaseException, status: int, said: str
) -> None:
    assert end_of(monkeypatch, error) == status
    printed, line = capsys.readouterr()
    assert not printed
    assert line.startswith(f"tactable: {said}") and line.count("\n") == 1 if said else not line


def test_an_error_of_the_program_itself_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ZeroDivisionError):
        end_of(monkeypatch, ZeroDivisionError())


@pytest.mark.parametrize(("encoding", "shown"), [("ascii", b"\\xb18 dB"), ("latin-1", b"\xb18 dB")])
def test_a_terminal_without_a_character_gets_its_code_and_the_rest(
    monkeypatch: pytest.MonkeyPatch, encoding: str, shown: bytes
) -> None:
    page = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(page, encoding))
    monkeypatch.setattr(sys, "argv", ["tactable", "check", "reference-a"])
    with pytest.raises(SystemExit) as end:
        main()
    sys.stdout.flush()
    assert not end.value.code
    assert shown in page.getvalue()


def workers_of(process: "subprocess.Popen[str]") -> list[int]:
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


@pytest.mark.machine(stall_s=None)
def test_a_build_that_is_struck_while_workers_solve_ends_in_a_line_and_leaves_no_process(tmp_path: Path) -> None:
    (tmp_path / "bar.toml").write_text(SMALL, encoding="utf-8")
    for is_interrupt in (False, True):
        with started(tmp_path, "build", "bar.toml", "-o", "bar.nc", "--workers", "3") as process:
            workers = list[int]()
            while len(workers) < 2:
                time.sleep(0.05)
                assert process.poll() is None, process.communicate()
                workers = workers_of(process)
            if is_interrupt:
                process.send_signal(signal.SIGINT)
            else:
                os.kill(workers[0], signal.SIGKILL)
            out, err = process.communicate()
        assert (process.returncode, out) == (130 if is_interrupt else 1, ""), err
        expected, usable, *line = err.splitlines()
        assert "ESTIMATE" in expected and usable.startswith("bar.nc: usable, with the clicks of one finger"), err
        assert len(line) == (not is_interrupt) and all(each.startswith("tactable: ") for each in line), err
        assert not any(Path(f"/proc/{worker}").exists() for worker in workers)
        with Table.open(tmp_path / "bar.nc") as table:  # whole
            assert table.clicks
        (tmp_path / "bar.nc").unlink()


WORDS = ("", "-3.2", "18.70 to 18.90 kN/m", "actuator[1].stiffness", "reaches only 11.4 dB", "±8 dB")


def test_brackets_in_names_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """Rich takes what is in brackets for markup, and drops it."""
    names = ["a[bold]b.nc", "zone [I]", "[/red]", "[link=x]y[/link]"]
    for name in names:
        console.OUT.print(name)
    grid = Grid(*names)
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
    grid = Grid("digitizer")
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
    grid = Grid("zone", "level dB", Column("interval", no_wrap=True), "what it lost", title="a title")
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


MOST_COMMANDS, MOST_OPTIONS = 40, 280
HEAVY = {"h5netcdf", "matplotlib", "numba", "numpy", "pint", "precompute", "scipy", "xarray"}
LIGHT = (["--help"], ["--version"], ["plot", "-h"], ["list", "--help"], ["list"], ["list", "--json"])
IMPORTED = """
import json, sys
from tactable.cli.main import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["tactable", *words]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
    print(json.dumps([words, sorted({name.partition(".")[0] for name in sys.modules})]), file=sys.stderr)
"""


@pytest.mark.machine(stall_s=None)
def test_help_and_list_load_neither_arrays_nor_compiler_nor_solver_nor_plot() -> None:
    """In one fresh interpreter: the help of all commands, the first, needs not even the engine."""
    command = [sys.executable, "-c", IMPORTED, json.dumps(LIGHT)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = [json.loads(line) for line in done.stderr.splitlines() if line.startswith('[["')]
    assert [words for words, _ in found] == list(LIGHT)
    assert "tactable" in found[0][1]
    assert set(found[0][1]).isdisjoint({"engine", "rich"}), "the help of the commands imports the engine"
    for words, loaded in found:
        assert set(loaded).isdisjoint(HEAVY), words


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("tactable pl", {"plot", "plan-measurements"}),
        ("tactable study ", {"placement", "resolution", "robustness"}),
        ("tactable calibrate --al", {"--also"}),
        ("tactable --ver", {"--version"}),
    ],
)
def test_a_shell_is_offered_commands_groups_and_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, offered: set[str]
) -> None:
    monkeypatch.setenv("_TACTABLE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    found = run_here(tmp_path).stdout.split()
    assert offered <= set(found)
    assert all(word.startswith(words.split(" ")[-1]) for word in found)


def test_h_is_help_everywhere_and_a_misspelt_command_is_answered_with_the_nearest(tmp_path: Path) -> None:
    for words in ((), ("plot",), ("plot", "state"), ("list",)):
        short, long = (CliRunner().invoke(app, [*words, option]) for option in ("-h", "--help"))
        assert short.exit_code == 0 and short.stdout == long.stdout
    assert run_here(tmp_path, "--version").stdout == f"tactable {version('tactable')}\n"
    done = run_here(tmp_path, "lits")
    assert done.returncode == 2 and "Did you mean 'list'" in done.stderr


def test_the_table_of_commands_says_what_their_functions_say() -> None:
    groups = {""}
    for sections in COMMANDS.values():
        for name, entry in (item for section in sections.values() for item in section.items()):
            if not entry.target:
                groups.add(name)
                continue
            module, _, function = entry.target.partition(":")
            text = getdoc(getattr(import_module(f"tactable.cli.{module}"), function or module)) or ""
            assert text.partition("\n\n")[0] == entry.help, name
            assert len(entry.help) <= 80 and entry.help.endswith("."), name
    assert set(COMMANDS) == groups


def test_there_are_no_more_commands_and_options_than_a_person_can_learn() -> None:
    """They are not to grow."""
    entries = [pair for sections in COMMANDS.values() for section in sections.values() for pair in section.items()]
    commands = [load_command(name, entry) for name, entry in entries if entry.target]
    options = [p for command in commands for p in command.params if p.param_type_name == "option" and p.name != "help"]
    assert len(commands) <= MOST_COMMANDS
    assert len(options) <= MOST_OPTIONS


def test_ctrl_c_during_imports_is_status_130_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupted:
        """Ctrl-C comes while the module of the command line is imported."""

        @staticmethod
        def find_spec(name: str, *_: object) -> None:
            if name == "tactable.cli.main":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "tactable.cli.main")
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    with pytest.raises(SystemExit) as end:
        start.main()
    assert end.value.code == 130
    assert capsys.readouterr() == ("", "")
