"""Verdicts of tests of the real machine, with evidence that these tests make up."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.tools import verdict
from tests.tools.stalls import Evidence, watched

Run = Callable[..., pytest.RunResult]
# Only against a watch that sees nothing.
PATIENCE_S = 60.0
FAILS = """
from pathlib import Path

import pytest

@pytest.fixture(scope="module")
def made():
    count = Path("made")
    count.write_text((count.read_text() if count.exists() else "") + "x")
    return count.read_text()

@pytest.mark.machine(stall_s={stall_s})
def test_law(made):
    assert len(made) >= {attempt}
"""


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs a module whose test fails before an attempt, on a machine that stands still for these times in turn."""

    def run(attempt: int, stalls_s: list[float], stall_s: float | None = 0.02) -> pytest.RunResult:
        stalls = iter(stalls_s)

        @contextmanager
        def watched(limit_s: float) -> Iterator[Evidence]:
            evidence = Evidence(limit_s)
            evidence.add("the machine stood still for", next(stalls))
            yield evidence

        monkeypatch.setattr(verdict, "watched", watched)
        pytester.makepyfile(FAILS.format(attempt=attempt, stall_s=stall_s))
        return pytester.runpytest_inprocess("-p", "tests.tools.verdict", "-p", "no:cacheprovider")

    return run


@pytest.mark.parametrize(
    ("attempt", "stalls_s", "verdict_line", "status"),
    [
        (1, [0.03], "1 holds, 0 not shown, 0 broken", 0),
        (3, [0.03, 0.03, 0.0], "1 holds, 0 not shown, 0 broken", 0),
        (9, [0.03, 0.01], "0 holds, 0 not shown, 1 broken", 1),
        (9, [0.03, 0.03, 0.03], "0 holds, 1 not shown, 0 broken", 0),
    ],
    ids=["holds though it stalled", "holds with fresh fixtures", "broken without a stall", "not shown"],
)
def test_a_failure_counts_only_in_an_attempt_without_a_stall(
    run: Run, attempt: int, stalls_s: list[float], verdict_line: str, status: int
) -> None:
    done = run(attempt, stalls_s)
    done.stdout.fnmatch_lines([f"*{verdict_line}"])
    assert done.ret == status


@pytest.mark.parametrize(("attempt", "verdict_line"), [(1, "1 holds, 0 not shown, 0 broken"), (2, "*1 broken")])
def test_no_stall_excuses_a_law_that_speaks_of_no_time(
    run: Run, pytester: pytest.Pytester, attempt: int, verdict_line: str
) -> None:
    done = run(attempt, [0.03] * 3, stall_s=None)
    done.stdout.fnmatch_lines([f"*{verdict_line}"])
    assert done.ret == attempt - 1
    assert (pytester.path / "made").read_text() == "x", "one attempt counts"


def test_the_third_check_in_a_row_without_a_quiet_attempt_fails(run: Run) -> None:
    assert [run(99, [0.03] * 3).ret for _ in range(3)] == [0, 0, 1]


def test_a_law_that_holds_is_counted_from_nothing() -> None:
    counts = [verdict.count_not_shown("law", is_not_shown=stalled) for stalled in (True, True, False, True)]
    assert counts == [1, 2, 0, 1]


@pytest.fixture
def busy() -> Iterator["subprocess.Popen[bytes]"]:
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as process:
        yield process
        process.kill()


@pytest.mark.machine
def test_a_stop_by_somebody_else_is_evidence_and_one_by_the_test_is_none(busy: "subprocess.Popen[bytes]") -> None:
    with watched() as evidence:
        os.kill(busy.pid, signal.SIGSTOP)
        time.sleep(0.2)
        os.kill(busy.pid, signal.SIGCONT)
    assert not any("stopped" in what for what in evidence.longest_s)
    with watched() as evidence:
        subprocess.run(["kill", "-STOP", str(busy.pid)], check=True)
        end_s = time.monotonic() + PATIENCE_S
        while not any(f"process {busy.pid} " in what and "stopped" in what for what in list(evidence.longest_s)):
            assert time.monotonic() < end_s
            time.sleep(0.01)
        subprocess.run(["kill", "-CONT", str(busy.pid)], check=True)
