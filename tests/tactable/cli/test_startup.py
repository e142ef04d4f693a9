"""How the command line starts: from its table of commands, importing little; the table and the functions agree."""

import json
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from inspect import getdoc
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tactable.cli import start
from tactable.cli.main import COMMANDS, app, load_command
from tests.tactable.cli.in_process import run_here

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
