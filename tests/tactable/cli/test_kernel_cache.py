"""Laws of the place for compiled kernels: numba's own where it may write, else a folder that goes with the command."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tactable.cli.kernel_cache import compile_steady_solver, provide_kernel_cache, refuse_open_caches

NOWHERE = Path("/proc/no-such-folder")
"""A place where nobody can make a folder, not even root."""


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(os, "environ", os.environ.copy())


def test_a_writable_package_or_home_is_left_to_numba(tmp_path: Path) -> None:
    assert provide_kernel_cache(tmp_path, NOWHERE) is None
    assert provide_kernel_cache(NOWHERE, tmp_path) is None
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_a_folder_that_the_user_names_is_taken(tmp_path: Path) -> None:
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


def test_a_cache_folder_that_others_can_write_is_none_for_kernels(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    assert "writable by you alone" in (provide_kernel_cache(NOWHERE, tmp_path) or "")


@pytest.mark.machine
def test_without_a_place_kernels_compile_and_go_with_the_process(tmp_path: Path) -> None:
    """In a process of its own that is told of places where nothing can be written."""
    program = f"""
import os, sys
from pathlib import Path
from tactable.cli.kernel_cache import compile_steady_solver, provide_kernel_cache
print(provide_kernel_cache(Path({str(NOWHERE)!r}), Path({str(NOWHERE)!r})))
import numba
@numba.njit(cache=True)
def twice(x): return 2 * x
print(twice(21), Path(os.environ["NUMBA_CACHE_DIR"]).is_dir(), os.environ["NUMBA_CACHE_DIR"])
"""
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[3])
    script = tmp_path / "kernel.py"  # numba keeps no kernel without a source file
    script.write_text(program, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, script], env=environment, capture_output=True, text=True, check=True, timeout=300
    )
    said, found = done.stdout.splitlines()
    assert f"neither {NOWHERE} nor {NOWHERE} is writable by you alone" in said and "Set NUMBA_CACHE_DIR" in said
    answer, existed, folder = found.split()
    assert (answer, existed) == ("42", "True") and not Path(folder).exists()


def test_compiling_the_steady_solver_is_said_only_where_no_cache_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactable.cli.kernel_cache.import_module", lambda _: None)
    os.environ["NUMBA_CACHE_DIR"] = str(tmp_path)
    lines: list[str] = []
    compile_steady_solver(lines.append)
    assert lines == ["compiling the solver of steady drives, once on this machine: about half a minute"]
    (tmp_path / "steady_1").mkdir()
    kept = tmp_path / "steady_1" / "search.find_drive-1.py311.nbi"
    kept.touch()
    compile_steady_solver(lines.append)
    assert len(lines) == 1
    os.utime(kept, (0, 0))  # older than its sources, as after an update of a checkout
    compile_steady_solver(lines.append)
    assert len(lines) == 2
