"""Work killed (SIGKILL) at many random instants, and started again each time: what it leaves is whole, and it ends.

What is killed is a fork of a process that has imported everything and computed nothing, and leads a session of its own:
imports would be most of the time of 200 kills. Processes that the work itself starts are new interpreters, as always.
"""

import json
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol

from engine.device import Device
from engine.table import Table
from engine.table.history import previous_of, replace_table
from precompute.builder.table_build import build_table
from precompute.clicks import ClickOptions
from precompute.fleet.fleet_run import DEVICE, OUTCOME, TABLE
from tests.precompute.fleet.small_fleet import small_text, write_measurements, write_unit
from tests.studies.trust.watched_run import WatchedRun, resting_run

ROOT = Path(__file__).parents[3]
CHEAP = ClickOptions(pitch_m=140e-3, pool=90, judged=10)
OLD, NEW = Device.parse(small_text(), "old"), Device.parse(small_text("20.5 kN/m"), "new")
_GONE_S = 60.0


class Work(Protocol):
    """What is killed: `imports` and then, in a fork, `script`, both the texts of a program."""

    imports: str
    script: str

    def prepare(self, folder: Path) -> None:
        """What there is before it is started for the first time, and again after it has ended."""

    def check(self, folder: Path) -> str:
        """Raise AssertionError, TableError ... for what is not whole; in a word, how far it was."""

    def check_end(self, folder: Path) -> None:
        """It ended by itself: everything is done."""


def whole_table(path: Path) -> Table:
    """Verified; closed, its best rows stay usable."""
    with Table.open(path) as table:
        assert table.best_rows
    return table


def check_pair(path: Path) -> Table:
    """The table that is there, and the one before it, if there is one."""
    if previous_of(path).exists():
        whole_table(previous_of(path))
    return whole_table(path)


class Build:
    """A table built in another's place, clicks and all, by two processes."""

    imports = """
from pathlib import Path
from engine.device import Device
from precompute.builder.table_build import build_table
from tests.studies.trust.kill_often import CHEAP
"""
    script = """
device = Device.read(Path("new.toml"))
build_table(device, "bar.nc", clicks_up_to=2, click_options=CHEAP, workers=2)
"""

    def prepare(self, folder: Path) -> None:
        """The old table, and the description of the new one."""
        (folder / "new.toml").write_text(NEW.text, encoding="utf-8")
        _put_old(folder)

    def check(self, folder: Path) -> str:
        """Old or new, both whole."""
        table = check_pair(folder / "bar.nc")
        assert table.fingerprint in (OLD.fingerprint, NEW.fingerprint)
        return "new table" if table.fingerprint == NEW.fingerprint else "old table"

    def check_end(self, folder: Path) -> None:
        """The new one with its clicks, and nothing beside it."""
        table = check_pair(folder / "bar.nc")
        assert table.fingerprint == NEW.fingerprint and len(table.clicks) == 12  # three places
        assert not list(folder.glob(".bar.nc*"))


class Calibrate:
    """`tactable calibrate --apply`: fitted, put in place with the clicks of one finger, then completed."""

    imports = """
import precompute.calibration.calibrate, precompute.builder.table_build, tactable.calibration.apply
from tactable.cli.main import app
"""
    script = """
words = "calibrate bar.toml measurements.csv -o fitted --starts 1 --apply bar.nc"
app(words.split(), standalone_mode=False)
"""
    files = ("fit.png", "measurements.csv", "reference-a.toml", "report.json", "report.md")

    def prepare(self, folder: Path) -> None:
        """The old table, measurements of a bar that has drifted from it."""
        shutil.rmtree(folder / "fitted", ignore_errors=True)
        if not (folder / "measurements.csv").exists():
            unit = write_unit(folder / "unit", small_text())
            write_measurements(unit, small_text("20.5 kN/m"))
            (unit / "device.toml").rename(folder / "bar.toml")
            (unit / "measurements.csv").rename(folder / "measurements.csv")
        _put_old(folder)

    def check(self, folder: Path) -> str:
        """A whole table, a whole folder or none; of the new bar as soon as there is a folder."""
        table, fitted = check_pair(folder / "bar.nc"), folder / "fitted"
        is_new = table.fingerprint != OLD.fingerprint
        if fitted.exists():
            assert sorted(path.name for path in fitted.iterdir()) == sorted(self.files)
            json.loads((fitted / "report.json").read_text(encoding="utf-8"))
            assert table.fingerprint == Device.read(fitted / "reference-a.toml").fingerprint
        is_complete = any(len(click.placement.position_m) > 1 for click in table.clicks)
        return "old table" if not is_new else "all clicks" if is_complete else "clicks of one finger"

    def check_end(self, folder: Path) -> None:
        """The folder, the new table with clicks of its own, the old one kept."""
        assert self.check(folder) == "all clicks"
        assert (folder / "fitted").exists()
        assert whole_table(previous_of(folder / "bar.nc")).fingerprint == OLD.fingerprint
        assert not list(folder.glob(".bar.nc*"))


class Swap:
    """A table and the one before put in each other's place, over and over, while a run plays them."""

    imports = """
from pathlib import Path
from engine.table.history import roll_back
"""
    script = """
for _ in range(30):
    roll_back(Path("bar.nc"))
"""

    def __init__(self, watched: WatchedRun) -> None:
        self._watched = watched

    def prepare(self, folder: Path) -> None:
        """Both tables are there."""
        assert check_pair(folder / "bar.nc")

    def check(self, folder: Path) -> str:
        """Both are whole, and the run goes on."""
        self._watched.look()
        self._watched.wait_for_reports(self._watched.reports + 1)
        return "old table" if check_pair(folder / "bar.nc").fingerprint == OLD.fingerprint else "new table"

    def check_end(self, folder: Path) -> None:
        """As at any time."""
        self.check(folder)


class Fleet:
    """Three units and a measured one, in one process or by a LocalCluster that goes down with it."""

    imports = """
from pathlib import Path
import precompute.builder.table_build, precompute.calibration.calibrate
from precompute.fleet.units import plan_fleet
from precompute.fleet.fleet_run import run_fleet, run_here, run_on_processes
from precompute.fleet.units import FleetOptions
"""
    units = 4

    def __init__(self, workers: int) -> None:
        self.script = f"""
pool = run_on_processes({workers}) if {workers} else run_here
run_fleet(plan_fleet(Path("bars")), FleetOptions(clicks_up_to=0), Path("out"), pool, created="2024-01-01")
"""

    def prepare(self, folder: Path) -> None:
        """The bars, and nothing of what comes of them."""
        shutil.rmtree(folder / "out", ignore_errors=True)
        if not (folder / "bars").exists():
            for i in range(self.units - 1):
                write_unit(folder / "bars" / f"good-{i}", small_text(f"{18 + i / 5:g} kN/m"))
            write_measurements(write_unit(folder / "bars" / "measured", small_text()), small_text("19.3 kN/m"))

    def check(self, folder: Path) -> str:
        """Every table and every outcome that is there is whole."""
        complete = 0
        for table in (folder / "out").glob(f"*/{TABLE}"):
            whole_table(table)
        for outcome in (folder / "out").glob(f"*/{OUTCOME}"):
            fingerprint = json.loads(outcome.read_text(encoding="utf-8"))["fingerprint"]
            with Table.open(outcome.parent / TABLE, device=Device.read(outcome.parent / DEVICE)) as opened:
                assert opened.fingerprint == fingerprint
            complete += 1
        return f"{complete} units"

    def check_end(self, folder: Path) -> None:
        """All of them."""
        assert self.check(folder) == f"{self.units} units"


def _put_old(folder: Path) -> None:
    """The old table in its place, with nothing kept beside it; built once."""
    kept, path = folder / "old.nc", folder / "bar.nc"
    if not kept.exists():
        build_table(OLD, kept, clicks_up_to=2, click_options=CHEAP)
    previous_of(path).unlink(missing_ok=True)
    shutil.copy(kept, folder / "copy.nc")
    replace_table(folder / "copy.nc", path, keep=False)


def kill_often(work: Work, folder: Path, times: int, seed: int = 0) -> tuple[Counter[str], int]:
    """Kill it so often: how far it was each time, and how often it ended. Raises what its checks raise."""
    instants, reached, ended = random.Random(seed), Counter[str](), 0
    body = textwrap.indent(work.script, "    ")
    (folder / "child.py").write_text(f"{work.imports}\ndef work():\n{body}\n{_SERVE}", encoding="utf-8")
    work.prepare(folder)
    with _Started(folder) as started:
        whole_s = started.run(None)
        assert whole_s is not None
        work.check_end(folder)
        work.prepare(folder)
        while sum(reached.values()) < times:
            if started.run(instants.uniform(0.0, whole_s)) is None:
                reached[work.check(folder)] += 1
                if sum(reached.values()) % 10 == 0:
                    print(f"{type(work).__name__}: killed {dict(reached)}, ended {ended}", file=sys.stderr, flush=True)
            else:
                ended += 1
                work.check_end(folder)
                work.prepare(folder)
        while started.run(None) is None:
            pass
    work.check_end(folder)
    return reached, ended + 1


# The process that is forked: it says the number of each fork, and how that ended.
_SERVE = """
def serve():
    import os, sys, traceback
    while sys.stdin.readline():
        child = os.fork()
        if child == 0:
            os.setsid()
            nothing = os.open(os.devnull, os.O_RDWR)
            os.dup2(nothing, 0)
            os.dup2(nothing, 1)
            try:
                work()
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)

if __name__ == "__main__":
    serve()
"""


class _Started:
    """The process that is forked, for the length of a `with` block."""

    def __init__(self, folder: Path) -> None:
        # GNU's OpenMP, which numba would take, ends a fork of a process that has used it.
        path = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_THREADING_LAYER": "workqueue"}
        path["PYTHONWARNINGS"] = "ignore::UserWarning:multiprocessing.resource_tracker"  # of what it cleans up
        command = [sys.executable, "child.py"]
        # Without a buffer, `select` sees what has not been read.
        self._server = subprocess.Popen(
            command, cwd=folder, env=path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )

    def __enter__(self) -> "_Started":
        return self

    def __exit__(self, *unused: object) -> None:
        self._server.communicate()

    def _hear(self, timeout_s: float | None) -> int | None:
        """The next number that it says."""
        assert self._server.stdout is not None
        ready, _, _ = select.select([self._server.stdout], [], [], timeout_s)
        return int(self._server.stdout.readline()) if ready else None

    def run(self, after_s: float | None) -> float | None:
        """Seconds that the program took, or None if it was killed after `after_s` and left no process."""
        assert self._server.stdin is not None
        self._server.stdin.write(b"fork\n")
        child, start_s = self._hear(_GONE_S), time.monotonic()
        assert child is not None
        status = self._hear(after_s)
        if status is None:
            with suppress(ProcessLookupError):  # it ended at this very instant
                os.kill(child, signal.SIGKILL)
            status = self._hear(_GONE_S)
        _wait_for_group(child)
        assert status in (0, -signal.SIGKILL)
        return time.monotonic() - start_s if status == 0 else None


def _wait_for_group(group: int) -> None:
    """The helpers of a killed process see that it is gone."""
    end_s = time.monotonic() + _GONE_S
    while time.monotonic() < end_s:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)
    raise AssertionError(f"processes of the killed one still live after {_GONE_S:g} s")


@contextmanager
def work_of(name: str, folder: Path) -> Iterator[Work]:
    if name == "swap":
        for device in (OLD, NEW):
            build_table(device, folder / "bar.nc", clicks_up_to=0)
        with resting_run(folder / "bar.nc", folder) as run:
            yield Swap(run)
    else:
        works: dict[str, Work] = {"build": Build(), "calibrate": Calibrate(), "fleet": Fleet(0)}
        yield works.get(name) or Fleet(2)
