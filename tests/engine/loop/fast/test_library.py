"""The compiled step as a library: compiled on the spot, trusted only where nobody else can have written it."""

from __future__ import annotations

import ctypes
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.loop.fast.library import FastPathError, compile_fast_path
from tests.tools.guard import allowed


@pytest.fixture(autouse=True)
def compiler() -> Iterator[None]:
    with allowed("compiles the step"):
        yield


@pytest.fixture(scope="module")
def library(fast_library: ctypes.CDLL) -> ctypes.CDLL:
    return fast_library


def test_it_is_compiled_once(tmp_path: Path, library: ctypes.CDLL) -> None:
    assert library is not None
    compile_fast_path(tmp_path)
    (made,) = tmp_path.iterdir()
    before = made.stat().st_mtime_ns
    compile_fast_path(tmp_path)
    assert [path.stat().st_mtime_ns for path in tmp_path.iterdir()] == [before]


def test_without_a_compiler_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(FastPathError, match="no C compiler: install one"):
        compile_fast_path(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"no library", b""])
def test_a_file_that_is_not_what_was_compiled_is_compiled_anew(
    tmp_path: Path, library: ctypes.CDLL, content: bytes
) -> None:
    path = tmp_path / Path(library._name).name
    path.write_bytes(content)
    compile_fast_path(tmp_path)
    assert path.read_bytes() == Path(library._name).read_bytes()


def test_a_library_that_others_can_write_is_compiled_anew(tmp_path: Path, library: ctypes.CDLL) -> None:
    path = tmp_path / Path(library._name).name
    for place, mode in ((path, 0o722), (tmp_path, 0o777)):
        path.unlink(missing_ok=True)  # it may be loaded
        path.write_bytes(Path(library._name).read_bytes())
        path.chmod(0o700)
        place.chmod(mode)
        before = path.stat().st_ino
        compile_fast_path(tmp_path)
        assert path.stat().st_ino != before
        assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(tmp_path.stat().st_mode) == 0o700


def test_where_others_can_replace_the_folder_nothing_is_compiled_or_loaded(
    tmp_path: Path, library: ctypes.CDLL
) -> None:
    path = tmp_path / "open" / "cache" / Path(library._name).name
    path.parent.mkdir(parents=True)
    path.write_bytes(Path(library._name).read_bytes())
    path.parent.parent.chmod(0o777)
    with pytest.raises(FastPathError, match=f"other users can change {path.parent.parent};"):
        compile_fast_path(path.parent)


def test_a_link_to_a_library_elsewhere_is_not_followed(tmp_path: Path, library: ctypes.CDLL) -> None:
    path = tmp_path / Path(library._name).name
    path.symlink_to(library._name)
    compile_fast_path(tmp_path)
    assert not path.is_symlink()


def test_a_library_without_the_symbols_is_an_error(
    tmp_path: Path, library: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A compiler that makes another library stands for a version of it that fits no more."""
    assert library is not None  # there is a compiler
    source = tmp_path / "other.c"
    source.write_text("int nothing(void) { return 0; }\n", encoding="ascii")
    monkeypatch.setattr("engine.loop.fast.library.SOURCE", source)
    with pytest.raises(FastPathError, match="fast_wait"):
        compile_fast_path(tmp_path / "cache")
