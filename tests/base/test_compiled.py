"""Kept machine code is used while everything that went into it is unchanged, and only then; numba looks at one file."""

import ast
import importlib
import os
import pickle
import runpy
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numba
import pytest

ROOT = Path(__file__).parents[2]
HELPER = """from {maker} import njit
FACTOR = {factor}
@njit(cache=True)
def scaled(x): return {slope} * x
"""
MAIN = """from {maker} import njit
from helper import FACTOR, scaled
@njit(cache=True)
def total(x): return scaled(x) + FACTOR
print(total(10.0), sum(total.stats.cache_hits.values()))
"""


def total(folder: Path, maker: str, factor: float, slope: float) -> tuple[float, bool]:
    """What a new process gets of a kernel with helper and constant in another file, and whether its code was kept."""
    for name, text in (("helper.py", HELPER), ("main.py", MAIN)):
        path, new = folder / name, text.format(maker=maker, factor=factor, slope=slope)
        if not path.is_file() or path.read_text(encoding="utf-8") != new:
            path.write_text(new, encoding="utf-8")
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    # Python itself looks at the second and the size of a source before it uses its bytecode again.
    environment |= {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, str(folder / "main.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
    value, hits = done.stdout.split()
    return float(value), hits == "1"


@pytest.mark.machine(stall_s=None)
def test_a_change_in_a_called_kernel_or_an_imported_constant_is_compiled_anew(tmp_path: Path) -> None:
    """Where numba alone goes on with the old code. If it does not any more, base/compiled.py can go."""
    assert total(tmp_path, "numba", 1, 2) == (21.0, False)
    assert total(tmp_path, "numba", 5, 3) == (21.0, True)
    assert total(tmp_path, "base.compiled", 1, 2) == (21.0, False)
    os.utime(tmp_path / "main.py", (0, 0))  # the time of a file is not what it says
    assert total(tmp_path, "base.compiled", 1, 2) == (21.0, True)
    assert total(tmp_path, "base.compiled", 1, 3) == (31.0, False)
    assert total(tmp_path, "base.compiled", 5, 3) == (35.0, False)


def test_kernels_in_an_archive_are_left_to_numba(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(tmp_path / "archived.zip", "w") as archive:
        archive.writestr("archived_kernel.py", HELPER.format(maker="base.compiled", factor=1, slope=2))
    monkeypatch.syspath_prepend(tmp_path / "archived.zip")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "kept"))
    archived = importlib.import_module("archived_kernel")
    assert archived.scaled(10.0) == 20.0
    assert archived.scaled._cache._impl.locator.contents is None
    assert list((tmp_path / "kept").rglob("*.nbi"))


class Planted:
    """A pickle that makes a file when it is read."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self._mark,)


def test_code_that_others_can_write_is_neither_read_nor_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, kept, mark = tmp_path / "kernel.py", tmp_path / "kept", tmp_path / "mark"
    source.write_text("from base.compiled import njit\n@njit(cache=True)\ndef twice(x): return 2 * x\n")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(kept))
    assert runpy.run_path(str(source))["twice"](1.0) == 2.0
    (index,) = kept.rglob("*.nbi")
    index.write_bytes(pickle.dumps(Planted(mark)))
    kept.chmod(0o777)
    with pytest.warns(UserWarning, match=rf"{kept}.*other users can change"):
        assert runpy.run_path(str(source))["twice"](1.0) == 2.0
    assert not mark.exists()
    assert list(tmp_path.glob("__pycache__/*.nbi"))  # its code is kept beside the source, as without a stated folder
    kept.chmod(0o700)
    assert runpy.run_path(str(source))["twice"](1.0) == 2.0
    assert mark.exists()  # where nobody else can have put it, it is read


def test_kernels_of_other_packages_are_left_to_numba() -> None:
    kernel: Any = numba.njit(cache=True)(lambda x: x)
    assert not hasattr(kernel._cache._impl.locator, "contents")


def test_every_kernel_is_made_here() -> None:
    for room in ("engine", "precompute"):
        for path in (ROOT / room).rglob("*.py"):
            nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module == "numba"]
            assert "njit" not in [each.name for node in imports for each in node.names]
