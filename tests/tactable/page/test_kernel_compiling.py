"""Laws of compiling kernels beside a page: the list is complete, and what plays first imports none, nor much else."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tactable.page.processes.build_process import BUILDS, STEADY, SWEEP

ROOT = Path(__file__).parents[3]
PLAYS_FIRST = ("tactable.page.opening", "tactable.page.processes.engine_process", "tactable.rig.ready")
PLAYED = f"""
import sys, {", ".join(PLAYS_FIRST)}
print(*sys.modules)
from pathlib import Path
from engine.steady.plain_solver import PlainSolver
from tactable.rig.first_table import open_first_table
from tactable.shipped import find_device
device = find_device("reference-a")
with open_first_table(device, Path("first.nc")) as table:
    assert PlainSolver(device, table.modes).solve([0.03, 0.2], [True, False], 20.0).achieved
print(*sys.modules)
"""
SLOW = {"numba", "scipy.fft", "scipy.signal", "scipy.stats"}
"""What takes as long to import as all the rest of a page, or longer."""


def test_every_module_with_a_declared_kernel_is_listed() -> None:
    declared = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for room in ("engine", "precompute", "tactable")
        for path in (ROOT / room).rglob("*.py")
        if re.search(r"^@njit\(\s*types\.", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert declared == {*STEADY, *SWEEP, *BUILDS}


@pytest.mark.machine(stall_s=None)
def test_what_plays_first_imports_nothing_slow_and_plays_without_a_compiler(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", PLAYED], capture_output=True, text=True, check=True, cwd=tmp_path)
    imported, after_a_drive = (set(line.split()) for line in done.stdout.splitlines())
    assert set(PLAYS_FIRST) < imported and not {*STEADY, *SWEEP, *BUILDS, *SLOW} & imported
    assert "engine.steady.plain_solver" in after_a_drive and "numba" not in after_a_drive
