"""Child processes: lines both ways, last words, and none that outlives its parent."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from base.child import Child, ChildError

pytestmark = pytest.mark.machine(stall_s=None)
PATIENCE_S = 60.0


def child(**arguments: Any) -> Child:
    return Child("tests.firmware_link.children", arguments, name="the test's child")


def is_running(process_id: int) -> bool:
    """Whether it runs; one that ended and whose parent is gone may lie as a zombie in a container without an init."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def wait_for_end(process_id: int) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while is_running(process_id):
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_lines_and_descriptors_go_both_ways_with_the_installed_child_whatever_it_prints_and_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "firmware_link").mkdir()
    (tmp_path / "firmware_link" / "__init__.py").write_text("raise ImportError('of the working folder')")
    monkeypatch.chdir(tmp_path)
    with child(do="echo") as it:
        assert it.read(PATIENCE_S) == {"ready": it.process_id, "input": ""}
        for text in ("a", "ä\n" * 3, "long" * 200_000):
            assert it.ask({"text": text}, PATIENCE_S) == {"heard": {"text": text}}
        it.ask_to_end()
        assert it.read(PATIENCE_S) == {"last": "words"}
        assert it.end() == 0
    ours, theirs = socket.socketpair()
    with ours, child(do="write") as it:
        it.write({"text": "by another process"}, [theirs.fileno()])
        theirs.close()
        assert ours.recv(100) == b"by another process"


def test_a_child_that_ends_early_or_is_silent_is_told_and_is_waited_for_with_an_end() -> None:
    for module, words in (
        ("tests.firmware_link.children", "the test's child: no such bar: plug one in"),
        ("tests.nowhere", r"the test's child: ModuleNotFoundError.*tests\.nowhere"),
    ):
        with Child(module, {"do": "fail"}, name="the test's child") as it, pytest.raises(ChildError, match=words):
            it.read(PATIENCE_S)
    with child(do="ignore") as it:
        it.read(PATIENCE_S)
        os.kill(it.process_id, signal.SIGKILL)
        with pytest.raises(ChildError, match="the test's child was ended by SIGKILL"):
            it.read(PATIENCE_S)
    with child(do="ignore") as it:
        it.read(PATIENCE_S)
        with pytest.raises(ChildError, match=r"has said nothing for 0\.01 s"):
            it.read(0.01)
        assert it.end(timeout_s=0.01) == -signal.SIGKILL


_INTERRUPTED = """
import signal
from base.child import Child
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background of a shell ignore it
with Child("tests.firmware_link.children", {"do": "echo"}) as it:
    try:
        print(it.read(60)["ready"], flush=True)
        it.read()
    except KeyboardInterrupt:
        print(it.ask({}), flush=True)
print(it.end())
"""


def test_a_child_ends_with_its_parent_and_ctrl_c_reaches_the_parent_only() -> None:
    for what in ("echo", "compute"):
        with child(do="start", what=what) as parent:
            grandchild = parent.read(PATIENCE_S)["ready"]
            assert is_running(grandchild)
            os.kill(parent.process_id, signal.SIGKILL)
            wait_for_end(grandchild)
    command = [sys.executable, "-c", _INTERRUPTED]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        grandchild = int(process.stdout.readline())
        os.killpg(process.pid, signal.SIGINT)  # as the terminal does
        # Exit status 1: the child had last words, and its parent had closed the stream.
        assert process.stdout.read().splitlines() == ["{'heard': {}}", "1"]
        assert not is_running(grandchild)
    assert process.returncode == 0
