"""The installed command in this process, where its modules are imported and its kernels compiled already."""

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tactable.cli.main import main
from tests.tools.virtual import VirtualLine


def run_here(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """`tactable WORDS` in `folder`: exit status and what it printed, as `subprocess.run` would tell it."""
    printed, complained, status = io.StringIO(), io.StringIO(), 0
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(complained),
    ):
        patch.chdir(folder)
        patch.setattr(sys, "argv", ["tactable", *words])
        try:
            main()
        except SystemExit as end:
            status = int(end.code or 0)
    return subprocess.CompletedProcess(words, status, printed.getvalue(), complained.getvalue())


def summary_of(folder: Path, *words: str) -> Any:
    """What `tactable WORDS --json` prints: JSON without what only Python reads, such as NaN."""
    done = run_here(folder, *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


class Line(VirtualLine):
    """A virtual line with what the commands say of a port: their clock and their port in this process."""

    path = "virtual port"
    notes = ()
    bit_rate_hz = 115_200

    def __enter__(self) -> "Line":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
