"""Processes of tests: the installed command as one of its own, and a number that no process has."""

import subprocess
import sys
from pathlib import Path

NO_PROCESS = 2**22 + 1
"""No process has it: Linux gives numbers up to 2**22."""


def started(folder: Path, *words: str) -> "subprocess.Popen[str]":
    """`tactable WORDS` in a folder, both outputs in pipes; it is waited for at the end of a `with` block."""
    command, pipe = [str(Path(sys.executable).parent / "tactable"), *words], subprocess.PIPE
    return subprocess.Popen(command, cwd=folder, text=True, stdout=pipe, stderr=pipe)
