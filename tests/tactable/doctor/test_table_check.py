"""Tables and kernels: fresh, stale, broken, and where kernels are kept."""

import ctypes
from pathlib import Path

import pytest

from precompute.builder.code_fingerprint import code_fingerprint
from tactable.doctor.table_check import check_fast_path, check_kernels, check_tables
from tactable.shipped import find_device
from tests.engine.made_table import write_table
from tests.tools.guard import allowed

DEVICE = find_device("reference-a")


def test_fresh_stale_and_broken_tables_are_told_apart(tmp_path: Path) -> None:
    fresh = write_table(tmp_path / "fresh.nc", DEVICE, code_fingerprint=code_fingerprint())
    stale = write_table(tmp_path / "stale.nc", DEVICE, code_fingerprint="another")
    broken = tmp_path / "broken.nc"
    broken.write_bytes(fresh.read_bytes()[:-100])
    checks = check_tables([fresh, stale, broken])
    delays, checks = (
        [check for check in checks if "delays" in check.name],
        [c for c in checks if "delays" not in c.name],
    )
    assert [(check.passed, check.needed) for check in checks] == [(True, True), (False, False), (False, True)]
    assert f"tactable build reference-a -o {stale}" in checks[1].remedy
    assert [check.finding.split(",")[:2] for check in delays] == [["left 0 us", " right 0 us"]] * 2


def test_kernels_that_are_kept_pass_and_others_say_how(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "tactable demo" in check_kernels(tmp_path).remedy
    (tmp_path / "steady.nbi").touch()
    assert check_kernels(tmp_path).passed
    monkeypatch.setattr("os.access", lambda *_: False)
    assert "NUMBA_CACHE_DIR" in check_kernels(tmp_path / "nowhere").remedy


def test_the_fast_path_is_made_or_its_compiler_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fast_library: ctypes.CDLL
) -> None:
    assert fast_library is not None
    with allowed("compiles the step"):
        assert check_fast_path(tmp_path / "made").passed
    monkeypatch.setenv("PATH", "")
    check = check_fast_path(tmp_path)
    assert (check.passed, check.needed) == (False, False)
    assert check.remedy.startswith("install one (gcc)")
