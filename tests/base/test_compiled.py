"""Kept machine code is used while everything that went into it is unchanged, and only then; numba looks at one file.

Laws of trust in a path: whoever can replace a part of the way to a file can replace the file.
"""

import ast
import grp
import importlib
import os
import pickle
import pwd
import runpy
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import pytest

from base.trust import open_to_others

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
USER = pwd.getpwuid(os.getuid()).pw_name


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


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """a/b/kept, for this user alone."""
    path = tmp_path / "a" / "b" / "kept"
    path.parent.mkdir(parents=True)
    path.write_text("code", encoding="ascii")
    for part in (path, path.parent, path.parent.parent):
        part.chmod(0o700)
    return path


def test_what_only_this_user_can_write_is_trusted_and_so_is_what_is_still_to_be_made(kept: Path) -> None:
    assert open_to_others(kept) is open_to_others(kept.parent) is None
    assert open_to_others(kept.parent / "new" / "folder") is None


@pytest.mark.parametrize(("mode", "group", "members", "is_trusted"), [
    (0o777, "staff", (), False), (0o702, "staff", (), False), (0o770, "staff", (), False),
    (0o770, USER, (), True), (0o770, USER, (USER,), True), (0o770, USER, (USER, "another"), False),
    (0o777, USER, (), False),
])  # fmt: skip
def test_a_part_that_others_can_write_is_named_and_the_group_of_one_user_s_own_name_is_that_user(
    kept: Path, mode: int, group: str, members: tuple[str, ...], is_trusted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the umask is 002, every folder is such a group's."""
    monkeypatch.setattr(grp, "getgrgid", lambda _: SimpleNamespace(gr_name=group, gr_mem=list(members)))
    for part in (kept, kept.parent, kept.parent.parent):
        part.chmod(mode)
        assert open_to_others(kept) == (None if is_trusted else part)
        part.chmod(0o700)


def test_of_a_sticky_folder_what_lies_in_it_is_trusted_and_not_the_folder_nor_a_link_to_itself(kept: Path) -> None:
    kept.parent.chmod(0o1777)
    assert open_to_others(kept) is None
    assert open_to_others(kept.parent) == kept.parent
    link = kept.with_name("link")
    link.symlink_to("link")
    assert open_to_others(link / "kept") == link


def test_what_belongs_to_root_is_trusted_and_what_belongs_to_another_user_is_not(kept: Path) -> None:
    assert open_to_others(Path("/usr/bin"), os.getuid() + 1) is None
    if os.getuid() == 0:  # whose own files everybody trusts
        os.chown(kept.parent, 12345, -1)
    assert open_to_others(kept, os.getuid() + 1) in kept.parents


@pytest.mark.parametrize("lead", [
    lambda link, kept: link.symlink_to(kept.parent),
    lambda link, kept: link.symlink_to(os.path.relpath(kept.parent, link.parent)),
    lambda link, kept: (link.with_name("second").symlink_to(kept.parent), link.symlink_to("second")),
])  # fmt: skip
def test_links_are_followed_and_the_folders_that_hold_them_count(
    kept: Path, tmp_path: Path, lead: Callable[[Path, Path], object]
) -> None:
    link = tmp_path / "links" / "first"
    link.parent.mkdir(mode=0o700)
    lead(link, kept)
    assert open_to_others(link / kept.name) is None
    link.parent.chmod(0o777)
    assert open_to_others(link / kept.name) == link.parent
    link.parent.chmod(0o700)
    kept.parent.chmod(0o777)
    assert open_to_others(link / kept.name) == kept.parent
