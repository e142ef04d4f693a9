"""The process that builds the page's table: it ends at any signal, and what plays first needs no kernel."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import precompute.builder.table_build
from base.child import Parent
from tactable.page.processes import build_process
from tactable.page.processes.build_process import BUILDS, STEADY, SWEEP, BuildOrder
from tactable.rig.ready import early_path


class Page(Parent):
    """Notes what the process says."""

    def __init__(self) -> None:
        self.said: list[dict[str, Any]] = []

    def end_with_it(self) -> None:
        pass

    def say(self, document: dict[str, Any]) -> None:
        self.said.append(document)


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Page:
    """The page of a process that compiles nothing and changes nothing of this one."""
    monkeypatch.setattr(os, "nice", lambda _: 0)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    for name in ("solve_first_click", "_compile", "write_first_table"):
        monkeypatch.setattr(build_process, name, lambda *_: None)
    return Page()


@pytest.mark.parametrize("is_there", [True, False])
def test_after_its_last_word_a_signal_ends_it_as_it_ends_any_process(
    is_there: bool, page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "table.nc"
    monkeypatch.setattr(build_process, "open_cached", lambda *_: SimpleNamespace(path=path) if is_there else None)
    monkeypatch.setattr(precompute.builder.table_build, "build_table", lambda _, early, **__: early.touch())
    build_process.main(page, {"order": BuildOrder("reference-a", path, tmp_path / "first.nc")})
    usable = [said["usable"] for said in page.said if said.keys() == {"usable"}]
    assert usable[-2 + is_there :] == [*([] if is_there else [str(early_path(path))]), str(path)]
    assert path.exists() is not is_there
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_signal_in_a_build_is_an_interrupt_and_ends_it(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build_process, "open_cached", lambda *_: None)
    monkeypatch.setattr(
        precompute.builder.table_build, "build_table", lambda *_, **__: signal.raise_signal(signal.SIGTERM)
    )
    path = tmp_path / "table.nc"
    with pytest.raises(SystemExit) as ended:
        build_process.main(page, {"order": BuildOrder("reference-a", path, tmp_path / "first.nc")})
    assert ended.value.code == 1 and not path.exists()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


ROOT = Path(__file__).parents[3]
PLAYS_FIRST = ("tactable.page.opening", "tactable.page.processes.engine_process", "tactable.rig.ready")
PLAYED = f"""
import sys, {", ".join(PLAYS_FIRST)}
print(*sys.modules)
from pathlib import Path
from engine.steady.plain_solver import PlainSolver
from tactable.rig.ready import open_first_table
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
        if re.search(r"^@(?:njit|kernel)\(\s*types\.", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert declared == {*STEADY, *SWEEP, *BUILDS}


@pytest.mark.machine(stall_s=None)
def test_what_plays_first_imports_nothing_slow_and_plays_without_a_compiler(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", PLAYED], capture_output=True, text=True, check=True, cwd=tmp_path)
    imported, after_a_drive = (set(line.split()) for line in done.stdout.splitlines())
    assert set(PLAYS_FIRST) < imported and not {*STEADY, *SWEEP, *BUILDS, *SLOW} & imported
    assert "engine.steady.plain_solver" in after_a_drive and "numba" not in after_a_drive
