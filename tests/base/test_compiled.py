"""Kept machine code is used while everything that went into it is unchanged, and only then; numba looks at one file."""

import ast
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


@pytest.mark.machine
def test_a_change_in_a_called_kernel_or_an_imported_constant_is_compiled_anew(tmp_path: Path) -> None:
    assert total(tmp_path, "base.compiled", 1, 2) == (21.0, False)
    assert total(tmp_path, "base.compiled", 1, 2) == (21.0, True)
    os.utime(tmp_path / "main.py", (0, 0))  # the time of a file is not what it says
    assert total(tmp_path, "base.compiled", 1, 2) == (21.0, True)
    assert total(tmp_path, "base.compiled", 1, 3) == (31.0, False)
    assert total(tmp_path, "base.compiled", 5, 3) == (35.0, False)


@pytest.mark.machine
def test_numba_alone_would_go_on_with_the_old_code(tmp_path: Path) -> None:
    """If this fails numba does it itself, and base/compiled.py can go."""
    assert total(tmp_path, "numba", 1, 2) == (21.0, False)
    assert total(tmp_path, "numba", 5, 3) == (21.0, True)


@pytest.mark.machine
def test_kernels_in_an_archive_are_left_to_numba(tmp_path: Path) -> None:
    texts = [text.format(maker="base.compiled", factor=1, slope=2) for text in (HELPER, MAIN)]
    with zipfile.ZipFile(tmp_path / "kernels.zip", "w") as archive:
        for name, text in zip(("helper.py", "main.py"), texts, strict=True):
            archive.writestr(name, text)
    environment = os.environ | {"PYTHONPATH": f"{tmp_path / 'kernels.zip'}:{ROOT}", "XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", "import main"]
    said = [
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300).stdout
        for _ in range(2)
    ]
    assert said == ["21.0 0\n", "21.0 1\n"]


class Planted:
    """A pickle that makes a file when it is read."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self._mark,)


def test_kept_code_that_others_can_write_is_neither_read_nor_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
            imports = [
                node
                for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                if isinstance(node, ast.ImportFrom)
            ]
            assert not [
                node for node in imports if node.module == "numba" and "njit" in [each.name for each in node.names]
            ]
