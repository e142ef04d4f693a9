"""Work killed (SIGKILL) at many random instants, and started again each time: what it leaves is whole, and it ends.

python -m tests.studies.kill_often WHAT TIMES, WHAT one of build, calibrate, swap, fleet, fleet-processes.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from engine.device import Device
from engine.table import Table
from engine.table.history import previous_of, replace_table
from precompute.builder.build import build_table
from precompute.builder.incremental import outdated_parts
from precompute.clicks import ClickOptions
from precompute.fleet.work import DEVICE, OUTCOME, TABLE
from tests.precompute.fleet.small_fleet import small_text, write_measurements, write_unit
from tests.studies.watched_run import resting_run

ROOT = Path(__file__).parents[2]
CHEAP = ClickOptions(lengths_s=(0.02,), pitch_m=140e-3, scenarios=2, trimmed=6, judged=10)
OLD, NEW = Device.parse(small_text(), "old"), Device.parse(small_text("20.5 kN/m"), "new")
_GONE_S = 60.0
_BEGIN = 'print("begun", flush=True)\n'


class Work(Protocol):
    """What is killed. `script` is the program's text, which says "begun" once it has imported what it needs."""

    script: str

    def prepare(self, folder: Path) -> None:
        """What there is before it is started for the first time, and again after it has ended."""

    def check(self, folder: Path) -> str:
        """Raise AssertionError, TableError ... for what is not whole; in a word, how far it was."""

    def check_end(self, folder: Path) -> None:
        """It ended by itself: everything is done."""


def whole_table(path: Path) -> Table:
    """Verified; closed, its entries stay usable."""
    with Table.open(path) as table:
        assert table.entries
    return table


def check_pair(path: Path) -> Table:
    """The table that is there, and the one before it, if there is one."""
    if previous_of(path).exists():
        whole_table(previous_of(path))
    return whole_table(path)


class Build:
    """A table built in another's place, clicks and all, by two processes."""

    script = f"""
from pathlib import Path
from engine.device import Device
from precompute.builder.build import build_table
from tests.studies.kill_often import CHEAP
if __name__ == "__main__":
    {_BEGIN}    device = Device.read(Path("new.toml"))
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
    """`tactable calibrate --apply`: fitted, built, put in place, then its clicks."""

    script = f"""
from tactable.cli.main import app
if __name__ == "__main__":
    import precompute.calibration.calibrate, precompute.builder.build, tactable.calibration.apply
    {_BEGIN}    words = "calibrate bar.toml measurements.csv -o fitted --starts 1 --apply bar.nc"
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
        return "clicks made" if is_new and not outdated_parts(table) else "new entries" if is_new else "old table"

    def check_end(self, folder: Path) -> None:
        """The folder, the new table with clicks of its own, the old one kept."""
        assert self.check(folder) == "clicks made"
        assert (folder / "fitted").exists()
        assert whole_table(previous_of(folder / "bar.nc")).fingerprint == OLD.fingerprint


class Swap:
    """A table and the one before put in each other's place, over and over, while a run plays them."""

    script = f"""
from pathlib import Path
from engine.table.history import roll_back
if __name__ == "__main__":
    {_BEGIN}    for _ in range(60):
        roll_back(Path("bar.nc"))
"""

    @contextmanager
    def running(self, folder: Path) -> Iterator[None]:
        """A run that plays the table meanwhile."""
        _put_old(folder)
        build_table(NEW, folder / "bar.nc", clicks_up_to=0)
        with resting_run(folder / "bar.nc", folder) as run:
            self._watched = run
            yield

    def prepare(self, folder: Path) -> None:
        """Both tables are there."""
        assert check_pair(folder / "bar.nc")

    def check(self, folder: Path) -> str:
        """Both are whole, and the run goes on."""
        self._watched.look()
        self._watched.wait_for_reports(len(self._watched.seen.index) + 1)
        return "old table" if check_pair(folder / "bar.nc").fingerprint == OLD.fingerprint else "new table"

    def check_end(self, folder: Path) -> None:
        """As at any time."""
        self.check(folder)


class Fleet:
    """Three units and a measured one, in one process or by a LocalCluster that goes down with it."""

    units = 4

    def __init__(self, workers: int) -> None:
        self.script = f"""
from pathlib import Path
from precompute.fleet.plan import plan_fleet
from precompute.fleet.run import run_fleet, run_here, run_on_processes
from precompute.fleet.units import FleetOptions
if __name__ == "__main__":
    {_BEGIN}    pool = run_on_processes({workers}) if {workers} else run_here
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
    (folder / "child.py").write_text(work.script, encoding="utf-8")
    work.prepare(folder)
    whole_s = _run(folder, None)
    assert whole_s is not None
    work.check_end(folder)
    work.prepare(folder)
    while sum(reached.values()) < times:
        if _run(folder, instants.uniform(0.0, whole_s)) is None:
            reached[work.check(folder)] += 1
        else:
            ended += 1
            work.check_end(folder)
            work.prepare(folder)
    while _run(folder, None) is None:
        pass
    work.check_end(folder)
    return reached, ended + 1


def _run(folder: Path, after_s: float | None) -> float | None:
    """Seconds from its beginning to its end; None: it was killed so long after it had begun, and nobody is left."""
    path = {**os.environ, "PYTHONPATH": str(ROOT)}
    child = subprocess.Popen(
        [sys.executable, "child.py"], cwd=folder, env=path, stdout=subprocess.PIPE, start_new_session=True
    )
    assert child.stdout is not None
    line = child.stdout.readline()
    start_s = time.monotonic()
    try:
        assert line == b"begun\n"
        child.communicate(timeout=after_s)
    except subprocess.TimeoutExpired:
        child.send_signal(signal.SIGKILL)
        child.communicate()
        _wait_for_group(child.pid)
        return None
    assert child.returncode == 0
    return time.monotonic() - start_s


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
    """The work of that name, what it needs running."""
    if name == "swap":
        swap = Swap()
        with swap.running(folder):
            yield swap
        return
    works: dict[str, Work] = {
        "build": Build(),
        "calibrate": Calibrate(),
        "fleet": Fleet(0),
        "fleet-processes": Fleet(2),
    }
    yield works[name]


def main() -> None:
    """Kill it so often; print how far it was."""
    name, times = sys.argv[1], int(sys.argv[2])
    with tempfile.TemporaryDirectory() as folder, work_of(name, Path(folder)) as work:
        reached, ended = kill_often(work, Path(folder), times)
    at = ", ".join(f"{count} at {word}" for word, count in sorted(reached.items()))
    print(f"{name}: killed {sum(reached.values())} times ({at}), ended {ended} times; all was whole")


if __name__ == "__main__":
    main()
