"""The guard: what a test uses of the machine fails it by name, unless it is marked or the use is allowed."""

import pytest

USES = """
import os, pty, select, signal, socket, subprocess, sys, threading, time
from pathlib import Path
import pytest
from tests.tools.guard import allowed

@pytest.fixture(scope="module")
def slept():
    time.sleep(1e-9)

def starts_a_process(): subprocess.run([sys.executable, "-c", ""])
def forks(): os.waitpid(os.fork() or os._exit(0), 0)
def opens_a_terminal(): [os.close(end) for end in pty.openpty()]
def binds():
    with socket.socket() as free: free.bind(("127.0.0.1", 0))
def sets_a_timer(): signal.setitimer(signal.ITIMER_REAL, 0)
def joins(): threading.current_thread()._started.is_set() and threading.Event().wait(1e-9)
def selects(): select.select([], [], [], 1e-9)

USES = [starts_a_process, forks, opens_a_terminal, binds, sets_a_timer, joins, selects]

@pytest.mark.parametrize("use", USES)
def test_unmarked(use): use()

@pytest.mark.machine
@pytest.mark.parametrize("use", USES)
def test_marked(use): use()

@pytest.mark.parametrize("use", USES)
def test_allowed(use):
    with allowed("compiles the C core"): use()

@pytest.mark.parametrize("number", [1, 2])
def test_of_a_fixture(slept, number): pass

def test_imports():
    Path("uses_a_process.py").write_text("import subprocess, sys; subprocess.run([sys.executable, '-c', ''])")
    import uses_a_process

def test_quiet(): time.sleep(0), threading.Lock().acquire(), select.select([], [], [], 0)
"""


@pytest.mark.machine(stall_s=None)
def test_what_a_test_or_its_fixture_uses_fails_it_unless_it_is_marked_or_allowed(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(USES)
    words = ("-p", "tests.tools.guard", "-p", "tests.tools.verdict", "-p", "no:cacheprovider")
    done = pytester.runpytest_inprocess(*words)
    done.assert_outcomes(failed=7 + 2, passed=7 + 7 + 2)
    done.stdout.fnmatch_lines(["*test_unmarked?starts_a_process? uses the machine: process at *"])
