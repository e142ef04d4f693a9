"""A page of Markdown to its fenced blocks, and the blocks run in order, as a reader would, in one folder.

| block | what happens to it |
|---|---|
| `sh` | every line is run; what says `# exit status 3`, or `0 or 3`, must end so, all else in 0 |
| `console` | lines after `$ ` are run; what follows is compared with what they print, `...` standing for anything |
| `python`, `pycon` | run, with one set of names a page; what `pycon` shows is compared as well |
| `toml` | read as TOML |
| `toml FILE`, `csv FILE` | written to that file, for what comes after |
| `sh hardware`, `console hardware` | needs a device: the commands and options must exist |
| `sh slow`, `console slow` | takes long, or a test of its own runs the same: likewise |
"""

import contextlib
import doctest
import io
import itertools
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.main import get_command

from tactable.cli import main as cli

ROOT = Path(__file__).parents[1]
_BIN = Path(sys.executable).parent
_FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
_STATUS = re.compile(r"# exit status (\d+)(?: or (\d+))?")
_ALIKE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
_OPERATORS = (">", ">>", "<", "|", "&&", "||", ";", "&")
_LIVE = ("emulate", "map", "measure", "play", "record", "replay", "run")
"""Commands that play a device in real time, or read what such a one has made."""
_PATIENCE_S = 60.0
"""Only against a process that hangs."""


@dataclass(frozen=True)
class Block:
    """One fenced block: where it begins, and the words behind its fence."""

    place: str
    language: str
    marks: tuple[str, ...]
    text: str

    @property
    def only_parses(self) -> bool:
        """Whether it is not run here."""
        return "hardware" in self.marks or "slow" in self.marks


@dataclass(frozen=True)
class Command:
    """One command line, what it is to print (None: not compared), and its exit status."""

    line: str
    expected: str | None

    @property
    def words(self) -> list[str]:
        """As the shell would part them."""
        return shlex.split(self.line, comments=True)

    @property
    def own_words(self) -> list[str]:
        """Those before the shell's first redirection, pipe or next command."""
        return list(itertools.takewhile(lambda word: word not in _OPERATORS, self.words))

    @property
    def is_live(self) -> bool:
        """Whether it needs the real machine: for a device that plays, or for another program."""
        return self.words[0] != "tactable" or self.own_words != self.words or self.words[1] in _LIVE

    @property
    def statuses(self) -> set[int]:
        """What it may end with; which of two depends on the machine."""
        found = _STATUS.search(self.line)
        return {int(status) for status in found.groups() if status} if found else {0}


def read_blocks(path: Path) -> list[Block]:
    text, blocks = path.read_text(encoding="utf-8"), []
    for found in _FENCE.finditer(text):
        language, *marks = found["info"].split() or [""]
        place = f"{path.name}:{text.count(chr(10), 0, found.start()) + 1}"
        blocks.append(Block(place, language, tuple(marks), found["text"]))
    return blocks


def read_commands(block: Block) -> list[Command]:
    text = block.text.replace("\\\n", " ")
    if block.language == "sh":
        return [Command(_plain(line), None) for line in text.splitlines() if line.strip() and line[0] != "#"]
    first, *parts = re.split(r"^\$ ", text, flags=re.MULTILINE)
    assert not first, f"{block.place}: a console block begins with a command, `$ ...`"
    lines = (part.partition("\n") for part in parts)
    return [Command(_plain(line), expected if expected.strip() else None) for line, _, expected in lines]


def _plain(line: str) -> str:
    return line.strip().removeprefix(".venv/bin/")


class Page:
    """One page being run in `folder`; its background processes end with it. `live`: only such commands, or no such."""

    def __init__(self, folder: Path, *, live: bool | None = None) -> None:
        self._folder = folder
        self._live = live
        self._names: dict[str, Any] = {"__name__": "__main__"}
        self._background: list[subprocess.Popen[str]] = []

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, *unused: object) -> None:
        for process in self._background:
            process.terminate()
        for process in self._background:
            process.communicate(timeout=_PATIENCE_S)

    def run(self, block: Block) -> None:
        """Do what the block says; AssertionError where it does not do what the page says."""
        if block.language in ("sh", "console"):
            for command in read_commands(block):
                if not block.only_parses:
                    if self._live in (None, command.is_live):
                        self._run_command(command, block.place)
                elif command.words[0] == "tactable":
                    check_command(command)
        elif block.language in ("python", "pycon") and self._live is False:
            return  # a snippet talks with the device of the command before it
        elif block.language == "python":
            exec(compile(block.text, block.place, "exec"), self._names)
        elif block.language == "pycon":
            self._run_examples(block)
        elif block.language in ("toml", "csv"):
            self._keep_file(block)

    def _run_command(self, command: Command, place: str) -> None:
        if command.line.endswith("&"):
            printed, status = self._start(command.line.removesuffix("&")), 0
        elif command.words[0] == "tactable" and command.own_words == command.words:
            printed, status = _call(command.words)
        else:
            printed, status = self._shell(command.line)
        assert status in command.statuses, f"{place}: {command.line}\nexit status {status}\n{printed}"
        if command.expected is not None:
            told = f"the page says\n{command.expected}\nand it said\n{printed}"
            assert is_alike(command.expected, printed), f"{place}: {command.line}\n{told}"

    def _start(self, line: str) -> str:
        """A process of its own that lives as long as the page; the first line that it says."""
        words = [str(_BIN / "tactable"), *shlex.split(line)[1:]]
        process = subprocess.Popen(words, cwd=self._folder, stdout=subprocess.PIPE, text=True)
        self._background.append(process)
        assert process.stdout is not None
        return process.stdout.readline()

    def _shell(self, line: str) -> tuple[str, int]:
        environment = {**os.environ, "PATH": f"{_BIN}{os.pathsep}{os.environ['PATH']}"}
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=self._folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return done.stdout, done.returncode

    def _keep_file(self, block: Block) -> None:
        if block.language == "toml":
            tomllib.loads(block.text)
        for name in block.marks:
            (self._folder / name).write_text(block.text, encoding="utf-8")

    def _run_examples(self, block: Block) -> None:
        examples = doctest.DocTestParser().get_doctest(block.text, self._names, block.place, block.place, 0)
        said = io.StringIO()
        failed, _ = doctest.DocTestRunner(optionflags=_ALIKE).run(examples, out=said.write, clear_globs=False)
        self._names.update(examples.globs)
        assert not failed, said.getvalue()


def _call(words: list[str]) -> tuple[str, int]:
    """The installed command in this process, where the kernels are compiled already: what it prints, how it ends."""
    printed, before = io.StringIO(), sys.argv
    sys.argv = words
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            cli.main()
    except SystemExit as end:
        return printed.getvalue(), int(end.code or 0)
    finally:
        sys.argv = before
    return printed.getvalue(), 0


def is_alike(expected: str, printed: str) -> bool:
    """Whether it printed what a page says: `...` in a line is any text, a line `...` any lines; spaces count as one."""
    said = "".join(f"{' '.join(line.split())}\n" for line in printed.splitlines())
    lines = [" ".join(line.split()) for line in expected.strip().splitlines()]
    parts = (r"(?:.*\n)*" if line == "..." else re.escape(line).replace(r"\.\.\.", ".*") + r"\n" for line in lines)
    return re.fullmatch("".join(parts), said) is not None


def check_command(command: Command) -> None:
    """The command and its options exist, and its values are of their kind; it is not run."""
    found: Any = get_command(cli.app)
    words = command.own_words[1:]
    while isinstance(found, cli.CommandGroup):
        assert words, f"{command.line}: names no command"
        assert words[0] in found.entries, f"{command.line}: there is no command {words[0]!r}"
        found, words = cli.load_command(words[0], found.entries[words[0]]), words[1:]
    try:
        found.make_context(found.name, words)
    except Exception as error:
        said = getattr(error, "format_message", None)
        if said is None:
            raise
        raise AssertionError(f"{command.line}: {said()}") from error


def relative_links(path: Path) -> Iterator[Path]:
    """The files of the repository that a page points to, pictures too."""
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
        yield path.parent / target
