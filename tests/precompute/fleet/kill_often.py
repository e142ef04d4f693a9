"""A fleet killed (SIGKILL) at many random instants, and run again each time: what it leaves is whole, and it ends.

python -m tests.precompute.fleet.kill_often TIMES WORKERS; with workers above 0 a LocalCluster goes down with it.
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
from pathlib import Path

from engine.device_file import read_device
from engine.table import open_table
from precompute.fleet.work import DEVICE, OUTCOME, TABLE
from tests.precompute.fleet.small_fleet import small_text, write_measurements, write_unit

UNITS = 3
_GOING_S = 2.0  # workers see that their parent is gone
_CHILD = """
import sys
from pathlib import Path
from precompute.fleet.plan import plan_fleet
from precompute.fleet.pool import run_here, run_on_processes
from precompute.fleet.run import run_fleet
from precompute.fleet.unit import Recipe

if __name__ == "__main__":
    workers = int(sys.argv[1])
    print("begun", flush=True)
    pool = run_on_processes(workers) if workers else run_here
    run_fleet(plan_fleet(Path("bars")), Recipe(clicks_up_to=0), Path("out"), pool, created="2024-01-01")
"""


def check(out: Path) -> int:
    """How many units are complete; every table and every outcome that is there is whole."""
    complete = 0
    for table in out.glob(f"*/{TABLE}"):
        open_table(table).close()
    for outcome in out.glob(f"*/{OUTCOME}"):
        folder = outcome.parent
        fingerprint = json.loads(outcome.read_text(encoding="utf-8"))["fingerprint"]
        with open_table(folder / TABLE, device=read_device(folder / DEVICE)) as opened:
            assert opened.fingerprint == fingerprint
        complete += 1
    return complete


def main() -> None:
    """Kill it so often; print how far it was each time it was."""
    times, workers = map(int, sys.argv[1:])
    instants = random.Random(0)
    whole_s, kills, finished, complete = 0.0, 0, 0, list[int]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i in range(UNITS):
            write_unit(folder / "bars" / f"good-{i}", small_text(f"{18 + i / 5:g} kN/m"))
        write_measurements(write_unit(folder / "bars" / "measured", small_text()), small_text("19.3 kN/m"))
        (folder / "child.py").write_text(_CHILD, encoding="utf-8")
        while kills < times:
            command = [sys.executable, "child.py", str(workers)]
            path = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
            child = subprocess.Popen(command, cwd=folder, env=path, stdout=subprocess.PIPE)
            assert child.stdout is not None
            child.stdout.readline()
            start_s = time.monotonic()
            try:
                child.wait(instants.uniform(0.0, whole_s) if whole_s else None)
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGKILL)
                child.wait()
                kills += 1
                time.sleep(_GOING_S if workers else 0.0)
                complete.append(check(folder / "out"))
                print(f"kill {kills}: {complete[-1]} of {UNITS + 1} units complete", flush=True)  # noqa: T201
            else:
                assert child.returncode == 0
                assert check(folder / "out") == UNITS + 1
                finished += 1
                whole_s = whole_s or time.monotonic() - start_s
                shutil.rmtree(folder / "out")
            child.stdout.close()
    at = ", ".join(f"{complete.count(n)} with {n}" for n in range(UNITS + 2))
    print(f"killed {kills} times ({at} units complete), finished {finished} times; every file was whole")  # noqa: T201


if __name__ == "__main__":
    main()
