"""Laws of the place for compiled kernels: numba's own where it may write, else a folder that goes with the command."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from numba.core.event import trigger_event

from tactable.kernel_cache import compile_steady_solver, provide_kernel_cache, refuse_open_caches

NOWHERE = Path("/proc/no-such-folder")
"""A place where nobody can make a folder, not even root."""


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(os, "environ", os.environ.copy())


def test_a_package_or_home_that_the_user_alone_can_write_or_names_is_left_to_numba(tmp_path: Path) -> None:
    assert provide_kernel_cache(tmp_path, NOWHERE) is None
    assert provide_kernel_cache(NOWHERE, tmp_path) is None
    assert "NUMBA_CACHE_DIR" not in os.environ
    tmp_path.chmod(0o777)
    assert "writable by you alone" in (provide_kernel_cache(NOWHERE, tmp_path) or "")
    os.environ["NUMBA_CACHE_DIR"] = str(tmp_path)
    assert provide_kernel_cache(NOWHERE, NOWHERE) is None
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path)


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_a_folder_that_others_can_write_is_forgotten_in_one_line(tmp_path: Path, variable: str) -> None:
    os.environ[variable] = str(tmp_path)
    assert list(refuse_open_caches()) == [] and os.environ[variable] == str(tmp_path)
    tmp_path.chmod(0o777)
    (line,) = refuse_open_caches()
    assert line.startswith(f"{variable}={tmp_path} is not used") and "chmod" in line and "\n" not in line
    assert variable not in os.environ and list(refuse_open_caches()) == []


def test_without_a_place_kernels_go_into_a_folder_of_the_process_or_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    at_end = list[Callable[[], object]]()
    monkeypatch.setattr("atexit.register", at_end.append)
    said = provide_kernel_cache(NOWHERE, NOWHERE)
    assert f"neither {NOWHERE} nor {NOWHERE} is writable by you alone" in (said or "")
    assert "Set NUMBA_CACHE_DIR" in (said or "")
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder.is_dir()
    for end in at_end:
        end()
    assert not folder.exists()
    monkeypatch.setattr("tempfile.tempdir", str(NOWHERE))
    del os.environ["NUMBA_CACHE_DIR"]
    assert "kernels cannot be compiled" in (provide_kernel_cache(NOWHERE, NOWHERE) or "")
    assert "NUMBA_CACHE_DIR" not in os.environ


@pytest.mark.parametrize("compiled", [0, 1, 3])
def test_that_the_solver_is_compiled_is_said_once_and_only_where_it_is(
    monkeypatch: pytest.MonkeyPatch, compiled: int
) -> None:
    def compile_kernels(_: str) -> None:
        for _number in range(compiled):
            with trigger_event("numba:compile"):
                pass

    monkeypatch.setattr("tactable.kernel_cache.import_module", compile_kernels)
    lines: list[str] = []
    compile_steady_solver(lines.append)
    assert lines == ["compiling the solver of steady drives, once on this machine: about half a minute"] * (
        compiled > 0
    )
