"""Ctrl-C before the command line is there."""

import subprocess
import sys

import pytest

# Ctrl-C comes while the first library of the command line is imported.
INTERRUPTED = """
import builtins, os, signal
plain = builtins.__import__
def interrupted(name, *others):
    if name == "typer":
        os.kill(os.getpid(), signal.SIGINT)
    return plain(name, *others)
builtins.__import__ = interrupted
from tactable.cli.start import main
main()
"""


@pytest.mark.machine
def test_ctrl_c_during_imports_is_status_130_without_a_traceback() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
