"""The library of the compiled step: made once, made again where it is another file, and refused."""

import ctypes
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.loop.fast.library import FastPathError, compile_fast_path
from tests.tools.guard import allowed


@pytest.fixture(autouse=True)
def compiler() -> Iterator[None]:
    with allowed("compiles the step"):
        yield


def test_it_is_compiled_once(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("content", [b"no library", b"", None], ids=["no library", "empty", "a link elsewhere"])
def test_another_file_is_compiled_anew(tmp_path: Path, fast_library: ctypes.CDLL, content: bytes | None) -> None:
    compiled = Path(fast_library._name)
    path = tmp_path / compiled.name
    if content is None:
        path.symlink_to(compiled)
    else:
        path.write_bytes(content)
    compile_fast_path(tmp_path)
    assert path.read_bytes() == compiled.read_bytes() and not path.is_symlink()


def test_a_library_without_the_symbols_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler that makes another library stands for a version of it that fits no more."""
    source = tmp_path / "other.c"
    source.write_text("int nothing(void) { return 0; }\n", encoding="ascii")
    monkeypatch.setattr("engine.loop.fast.library.SOURCE", source)
    with pytest.raises(FastPathError, match="fast_wait"):
        compile_fast_path(tmp_path / "cache")
