"""Laws of compiling kernels beside a page: the list is complete, and what plays first imports none, nor much else."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tactable.rig.kernels import BUILDS, CLICKS, STEADY, SWEEP

ROOT = Path(__file__).parents[3]
PLAYS_FIRST = ("tactable.page.opening", "tactable.page.processes.engine", "tactable.rig.ready")
SLOW = {"numba", "scipy.fft", "scipy.signal", "scipy.stats"}
"""What takes as long to import as all the rest of a page, or longer."""


def test_every_module_with_a_declared_kernel_is_listed() -> None:
    declared = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for room in ("engine", "precompute", "tactable")
        for path in (ROOT / room).rglob("*.py")
        if re.search(r"^@njit\(\s*types\.", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert declared == {*CLICKS, *STEADY, *SWEEP, *BUILDS}


@pytest.mark.machine
def test_what_plays_first_compiles_nothing_and_imports_nothing_slow() -> None:
    listed = f"import sys, {', '.join(PLAYS_FIRST)}; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", listed], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not {*CLICKS, *STEADY, *SWEEP, *BUILDS, *SLOW} & set(found.stdout.split())
