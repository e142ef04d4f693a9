"""The process that builds the page's table: a signal ends it whenever it comes, and what was built is kept."""

import os
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import precompute.builder.table_build
from base.child import Parent
from tactable.page.processes import build_process
from tactable.page.processes.build_process import BuildOrder
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
