"""A fleet through a scheduler and workers that were started by hand; workers and the command itself are killed."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from precompute.fleet.fleet_run import OUTCOME
from tests.precompute.fleet.small_fleet import small_text, write_unit
from tests.precompute.fleet.test_fleet_run import BROKEN, assert_complete, write_broken
from tests.tactable.cli.in_process import run_here

pytestmark = pytest.mark.machine(stall_s=None)

BIN = Path(sys.executable).parent
GOOD = 4
# Only against processes that hang: a minute does on a crowded machine.
LIMIT_S = 600.0


class Crew:
    """A scheduler and workers, each a process of its own; all are ended."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._file = folder, folder / "scheduler.json"
        self._processes = list[subprocess.Popen[bytes]]()
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        wait_for(self._file.is_file)
        self.address = str(json.loads(self._file.read_text(encoding="utf-8"))["address"])

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        command = [str(BIN / "dask"), words[0], "--scheduler-file", str(self._file), *words[1:]]
        with (self._folder / "log.txt").open("ab") as log:
            process = subprocess.Popen(command, cwd=self._folder, stdout=log, stderr=log)
        self._processes.append(process)
        return process

    def worker(self) -> subprocess.Popen[bytes]:
        """Another one, of one thread, that nobody starts again."""
        return self._start("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def end(self) -> None:
        for process in reversed(self._processes):
            process.kill()
            process.wait()


def wait_for(happened: Callable[[], object]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not happened():
        assert time.monotonic() < end_s
        time.sleep(0.05)


@pytest.fixture
def crew(tmp_path: Path) -> Iterator[Crew]:
    crew = Crew(tmp_path)
    yield crew
    crew.end()


@pytest.fixture
def bars(tmp_path: Path) -> Path:
    for i in range(GOOD):
        write_unit(tmp_path / "bars" / f"good-{i}", small_text(f"{18 + i / 10:g} kN/m"))
    write_broken(tmp_path / "bars")
    return tmp_path / "bars"


def start(bars: Path, address: str) -> subprocess.Popen[bytes]:
    words = ("fleet", str(bars), "-o", str(bars.parent / "out"), "--scheduler", address, "--clicks-up-to", "0")
    return subprocess.Popen([str(BIN / "tactable"), *words], stdout=subprocess.PIPE)


def assert_done(bars: Path, process: subprocess.Popen[bytes]) -> dict[str, str]:
    """Status of every unit."""
    process.communicate(timeout=LIMIT_S)
    assert process.returncode == 3
    units = json.loads((bars.parent / "out" / "summary.json").read_text(encoding="utf-8"))["units"]
    assert {unit["name"] for unit in units if unit["status"] == "failed"} == set(BROKEN)
    for i in range(GOOD):
        assert_complete(bars.parent / "out" / f"good-{i}")
    return {unit["name"]: unit["status"] for unit in units}


def outcomes(bars: Path) -> list[Path]:
    return list((bars.parent / "out").glob(f"*/{OUTCOME}"))


def test_a_scheduler_that_is_not_there_is_named_and_a_killed_worker_or_command_costs_nothing_but_time(
    crew: Crew, bars: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr("precompute.fleet.fleet_run._PATIENCE_S", 1.0)
        words = ("fleet", str(bars), "-o", str(bars.parent / "none"), "--clicks-up-to", "0")
        done = run_here(bars, *words, "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 1
    assert done.stderr.startswith("tactable: ") and "tcp://127.0.0.1:9" in done.stderr

    first = crew.worker()
    process = start(bars, crew.address)
    wait_for(lambda: outcomes(bars))
    first.kill()
    first.wait()
    built = len(outcomes(bars))
    crew.worker()
    wait_for(lambda: len(outcomes(bars)) > min(built, GOOD - 1))  # the first may have built all before it was killed
    process.send_signal(signal.SIGKILL)
    process.communicate()
    statuses = assert_done(bars, start(bars, crew.address))
    assert list(statuses.values()).count("kept") >= 2
