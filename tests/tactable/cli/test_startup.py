"""How the command line starts: from its table of commands, importing little; the table and the functions agree."""

import os
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from inspect import getdoc

import pytest
from typer.testing import CliRunner

from tactable.cli.main import COMMANDS, Entry, app

pytestmark = pytest.mark.machine

HEAVY = {"h5netcdf", "matplotlib", "numba", "numpy", "pint", "precompute", "scipy", "xarray"}
TARGETS = [
    (f"{group} {name}".strip(), entry)
    for group, sections in COMMANDS.items()
    for section in sections.values()
    for name, entry in section.items()
]


def modules_after(*words: str) -> set[str]:
    """Top-level packages that a fresh interpreter has loaded when the command ends."""
    program = f"""
import sys
from tactable.cli.main import main
sys.argv = ["tactable", *{words!r}]
try:
    main()
finally:
    print(*{{name.partition(".")[0] for name in sys.modules}}, file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(done.stderr.splitlines()[-1].split())


@pytest.mark.parametrize(
    "words", [("--help",), ("--version",), ("list",), ("list", "--json"), ("plot", "-h"), ("list", "--help")]
)
def test_help_and_list_load_neither_arrays_nor_compiler_nor_solver_nor_plot(words: tuple[str, ...]) -> None:
    loaded = modules_after(*words)
    assert "tactable" in loaded
    assert loaded.isdisjoint(HEAVY)


def completed(words: str) -> list[str]:
    """What a shell would offer for the last of these words."""
    asked = {"_TACTABLE_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    program = "from tactable.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | asked, capture_output=True, text=True, check=False
    )
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("tactable pl", {"plot", "plan-measurements"}),
        ("tactable study ", {"placement", "resolution"}),
        ("tactable calibrate --al", {"--also"}),
        ("tactable --ver", {"--version"}),
    ],
)
def test_a_shell_is_offered_commands_groups_and_options(words: str, offered: set[str]) -> None:
    found = completed(words)
    assert offered <= set(found)
    assert all(word.startswith(words.split(" ")[-1]) for word in found)


def test_the_version_is_that_of_the_package() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.argv = ['tactable', '--version']; import tactable.cli.main as m; m.main()",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"tactable {version('tactable')}\n"


@pytest.mark.parametrize("words", [(), ("plot",), ("plot", "state"), ("list",)])
def test_h_is_help_everywhere(words: tuple[str, ...]) -> None:
    short, long = (CliRunner().invoke(app, [*words, option]) for option in ("-h", "--help"))
    assert short.exit_code == 0 and short.stdout == long.stdout


def test_the_help_of_the_commands_needs_not_even_the_engine() -> None:
    assert modules_after("--help").isdisjoint({"engine", "rich"})


@pytest.mark.parametrize(("name", "entry"), TARGETS, ids=[name for name, _ in TARGETS])
def test_the_table_says_what_the_function_says(name: str, entry: Entry) -> None:
    if not entry.target:
        assert name in COMMANDS
        return
    module, _, function = entry.target.partition(":")
    text = getdoc(getattr(import_module(f"tactable.cli.{module}"), function)) or ""
    assert text.partition("\n\n")[0] == entry.help
    assert len(entry.help) <= 80 and entry.help.endswith(".")


def test_every_group_is_listed() -> None:
    assert set(COMMANDS) == {"", *(name for name, entry in TARGETS if not entry.target)}


def test_the_help_lists_every_command_by_section() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from tactable.cli.main import main; main()", "--help"],
        capture_output=True,
        text=True,
        check=True,
        env={"COLUMNS": "120"},
    )
    titles = [line[:-1] for line in done.stdout.splitlines() if line.endswith(":") and line[0] != " "]
    assert titles == ["Options", *COMMANDS[""]]
    for section in COMMANDS[""].values():
        for name, entry in section.items():
            assert f"  {name} " in done.stdout and entry.help in done.stdout


def test_a_misspelt_command_is_answered_with_the_nearest() -> None:
    program = "from tactable.cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", program, "lits"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Did you mean 'list'" in done.stderr
