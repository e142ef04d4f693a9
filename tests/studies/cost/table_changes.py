"""Time from measurements to the new table playing, and cost of a change of table to the run that plays. SIMULATED.

`python -m tests.studies.cost.table_changes [--changes N]` proves on real
processes that `calibrate --apply` reaches a running `tactable run`, and that changes of table under 1000 reports a
second lose no report and make no more commands late than the same run has without them.
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from base.arrays import Integers
from engine.device import Device
from engine.device.texts import text_with_values
from engine.table.history import replace_table
from precompute.builder.table_build import build_table
from precompute.parallel.pool import available_cores
from tactable.shipped import find_device, find_device_file
from tests.studies.options import read_options
from tests.studies.trust.watched_run import resting_run, touches, watched_run

Times = Integers

TACTABLE = (sys.executable, "-c", "from tactable.cli.main import main; main()")
DEVICE = "reference-a"
RATE_HZ, FRAME_NS = 1000, 1_000_000
WAITING_REPORTS = 63
"""Reports that hidraw keeps for a program that does not read."""
_SEGMENT_CHANGES = 100
_SEGMENT_S, _CONTROL_S = 150.0, 30.0
_PLACES = (0.1, 0.3, 0.5, 0.7, 0.9)
_AFTER_NS = 20_000_000
"""A change shows in the reports that are due up to this long after it, or it does not show."""
_STIFFNESS = ("18.9 kN/m", "20.5 kN/m")
_DRIFT = ("actuator[1].stiffness=20.5 kN/m", "actuator.full_scale=0.48 µm")


def measure_chain(folder: Path) -> dict[str, Any]:
    """Seconds from the start of `calibrate --apply` on drifted, SIMULATED measurements until a run has changed over."""
    table, measured = folder / "chain.nc", folder / "measured.csv"
    build_table(find_device(DEVICE), table, clicks_up_to=0, workers=available_cores())
    changes = [word for change in _DRIFT for word in ("--change", change)]
    _run(folder, "simulate-measurements", str(find_device_file(DEVICE)), "-o", str(measured), *changes)
    with resting_run(table, folder) as run:
        start_s = time.perf_counter()
        words = ("calibrate", DEVICE, str(measured), "-o", str(folder / "fitted"), "--apply", str(table), "--json")
        applying = subprocess.Popen([*TACTABLE, *words], stdout=subprocess.PIPE)
        run.wait_for_change()
        playing_s = time.perf_counter() - start_s
        told, _ = applying.communicate()
    said = json.loads(told)["applied"]
    return {
        "playing_after_s": playing_s,
        "in_place_after_s": said["in_place_after_s"],
        "interpreter_and_the_rest_s": playing_s - sum(said["seconds"].values()),
        "seconds": said["seconds"],
        "entries_changed": said["diff"]["entries"]["changed"],
    }


def make_tables(folder: Path) -> tuple[Path, Path]:
    """Two tables of a device on a coarse grid, with all its states, that drive differently."""
    coarse = {"sweep.step": "10 Hz", "sweep.amplitude_steps": "2", "sweep.phase_steps": "8"}
    text, paths = find_device(DEVICE).text, []
    for number, stiffness in enumerate(_STIFFNESS):
        path = folder / f"table-{number}.nc"
        values = {**coarse, "actuator[1].stiffness": stiffness}
        device = Device.parse(text_with_values(text, values, DEVICE), DEVICE)
        build_table(device, path, clicks_up_to=0, workers=available_cores())
        paths.append(path)
    return paths[0], paths[1]


def _run(folder: Path, *words: str) -> None:
    subprocess.run([*TACTABLE, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)


@dataclass(frozen=True)
class Segment:
    """One run: its summary, lateness of every report (ns), and when they were due and tables changed."""

    summary: dict[str, Any]
    lost: int
    late_ns: Times
    due_ns: Times
    due_to_written_ns: Times
    change_ns: Times

    def pauses_ns(self, instants_ns: Times) -> Times:
        """How late the latest report was of those due about each instant; a moment without any counts as 0."""
        first, last = (np.searchsorted(self.due_ns, instants_ns + reach) for reach in (-_AFTER_NS, _AFTER_NS))
        return np.array([self.late_ns[a:b].max(initial=0) for a, b in zip(first, last, strict=True)], np.int64)


def measure_changes(tables: tuple[Path, Path], count: int, folder: Path) -> dict[str, Any]:
    """`count` changes between two tables under RATE_HZ reports a second, and in between runs without one."""
    with_changes, without, left = list[Segment](), list[Segment](), count
    while left > 0:
        with_changes.append(_measure(tables, min(left, _SEGMENT_CHANGES), _SEGMENT_S, folder))
        without.append(_measure(tables, 0, min(_CONTROL_S, with_changes[-1].late_ns.size / RATE_HZ + 2), folder))
        left -= max(1, len(with_changes[-1].change_ns))
    pauses = np.concatenate([segment.pauses_ns(segment.change_ns) for segment in with_changes])
    pairs = zip(without, with_changes, strict=True)
    others = [segment.pauses_ns(_even(segment, len(other.change_ns))) for segment, other in pairs]
    return {
        "with": _figures(with_changes),
        "without": _figures(without),
        "pause_ms": _quantiles(pauses),
        "no_pause_ms": _quantiles(np.concatenate(others)),
    }


def _measure(tables: tuple[Path, Path], changes: int, seconds: float, folder: Path) -> Segment:
    table = folder / "played.nc"
    _put(tables[0], table)
    with watched_run(table, touches(seconds, RATE_HZ, _PLACES), folder) as run:
        run.wait_for_reports(RATE_HZ)  # settled
        for number in range(changes):
            if len(run.seen.index) > RATE_HZ * (seconds - 5):
                break
            _put(tables[(number + 1) % 2], table)
            run.wait_for_change()
        while not changes and len(run.seen.index) < RATE_HZ * (seconds - 1):
            run.look()
        run.look()
        summary = run.end()
        seen = run.seen
    index, read_ns = np.array(seen.index, np.int64), np.array(seen.read_ns, np.int64)
    due_ns = read_ns[0] + (index - index[0]) * FRAME_NS
    return Segment(
        summary=summary,
        lost=seen.lost + int((np.diff(index) - 1).sum()),
        late_ns=read_ns - due_ns,
        due_ns=due_ns,
        due_to_written_ns=np.array(seen.due_to_written, np.int64),
        change_ns=np.array(seen.change_ns, np.int64),
    )


def _put(source: Path, table: Path) -> None:
    """Another file in the table's place, as a build puts it there."""
    new = table.with_name("new.nc")
    new.hardlink_to(source)
    replace_table(new, table)


def _even(segment: Segment, count: int) -> Times:
    return np.linspace(segment.due_ns[0], segment.due_ns[-1], count + 2)[1:-1].astype(np.int64)


def _figures(segments: Sequence[Segment]) -> dict[str, Any]:
    written_ns = np.concatenate([segment.due_to_written_ns for segment in segments])
    late_ns = np.concatenate([segment.late_ns for segment in segments])
    late = int((written_ns >= FRAME_NS).sum())
    digitizers = [segment.summary["digitizer"] for segment in segments]
    return {
        "changes": sum(len(segment.change_ns) for segment in segments),
        "changes_counted_by_the_run": sum(segment.summary["changes_of_table"] for segment in segments),
        "reports": sum(segment.summary["reports"] for segment in segments),
        "sessions_lost": sum(segment.summary["reconnects"] for segment in segments),
        "reports_lost": sum(segment.lost for segment in segments) + sum(each["lost_frames"] for each in digitizers),
        "reports_63_ms_late": int((late_ns >= WAITING_REPORTS * FRAME_NS).sum()),
        "commands": len(written_ns),
        "commands_late": late,
        "commands_late_percent": 100 * late / max(1, len(written_ns)),
        "command_p50_ms": float(np.percentile(written_ns, 50)) / 1e6,
        "command_p99_ms": float(np.percentile(written_ns, 99)) / 1e6,
        "command_max_ms": float(written_ns.max()) / 1e6,
        "report_p99_ms": float(np.percentile(late_ns, 99)) / 1e6,
        "report_max_ms": float(late_ns.max()) / 1e6,
    }


def _quantiles(found_ns: Times) -> dict[str, float]:
    values = {name: np.percentile(found_ns, percent) for name, percent in (("50 %", 50), ("90 %", 90), ("99 %", 99))}
    return {name: float(value) / 1e6 for name, value in {**values, "greatest": found_ns.max()}.items()}


def main() -> None:
    """Print what was measured: the chain from measurements to playing, then the changes beside the run without."""
    asked = read_options(__doc__, changes=1000)
    with tempfile.TemporaryDirectory(prefix="tactable-study-") as name:
        folder = Path(name)
        result = {
            "simulated": True,
            "machine": {"python": platform.python_version(), "cores": os.cpu_count(), "load": os.getloadavg()[0]},
            "chain": measure_chain(folder),
            "changes": measure_changes(make_tables(folder), asked.changes, folder),
        }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
