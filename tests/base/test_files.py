"""Laws of replacing a file."""

import contextlib
import os
import resource
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from base import files
from base.files import FolderError, WriteError, remove_all_partials, remove_partials, replace_file, write_new_folder
from tests.tools.processes import NO_PROCESS


@pytest.fixture
def report(tmp_path: Path) -> Path:
    """A file that is to be replaced."""
    path = tmp_path / "report.json"
    path.write_text("old")
    return path


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("mode", [0o600, 0o664, 0o755])
def test_until_the_rename_the_old_file_stays_and_then_the_new_one_has_its_permissions(report: Path, mode: int) -> None:
    report.chmod(mode)
    with pytest.raises(ZeroDivisionError), replace_file(report) as partial:
        partial.write_text("half")
        raise ZeroDivisionError
    assert (report.read_text(), names(report.parent)) == ("old", {"report.json"})
    with replace_file(report) as partial:
        partial.write_text("new")
        partial.with_name(f".report.json.{NO_PROCESS}.partial").write_text("half")
        assert report.read_text() == "old"
        remove_partials(report)
        assert names(report.parent) == {"report.json", partial.name}
    assert (report.read_text(), names(report.parent)) == ("new", {"report.json"})
    assert stat.S_IMODE(report.stat().st_mode) == mode


def test_the_file_is_flushed_before_the_rename_and_the_folder_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, flushed, flush = tmp_path / "report.json", list[tuple[str, bool]](), os.fsync

    def record(descriptor: int) -> None:
        kind = "folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file"
        flushed.append((kind, path.exists()))
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", record)
    with replace_file(path) as partial:
        partial.write_text("new")
    assert flushed == [("file", False), ("folder", True)]


@contextlib.contextmanager
def full_disk(room: int) -> Iterator[None]:
    """A write beyond so many bytes of a file fails, as it does where the disk is full."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_one_error_that_names_the_file_and_leaves_the_old_one(report: Path) -> None:
    too_large = "cannot be written there: File too large; make room"
    with full_disk(4096), pytest.raises(WriteError, match=f"report.json: {too_large}"), replace_file(report) as partial:
        partial.write_bytes(bytes(10_000))
    with full_disk(4096), pytest.raises(WriteError, match=f"new: {too_large}"):
        write_new_folder(report.with_name("new"), {"a": b"1", "b": bytes(10_000)})
    assert (report.read_text(), names(report.parent)) == ("old", {"report.json"})


@pytest.mark.parametrize(("path", "reason"), [
    ("/proc/self/report.json", "cannot be written there: No such file"),
    ("missing/report.json", "cannot be written there: No such file"),
    ("pipe", "is not a plain file, and is not replaced"),
    ("link", "is not a plain file, and is not replaced"),
])  # fmt: skip
def test_one_error_names_a_path_that_takes_no_file_or_is_no_plain_one_and_nothing_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str, reason: str
) -> None:
    """As root, writing a report to /dev/null would take it from the whole machine."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("link").symlink_to("pipe")
    with pytest.raises(WriteError, match=f"^{path}: {reason}"), replace_file(Path(path)) as partial:
        partial.write_text("new")
    assert stat.S_ISFIFO(Path("pipe").stat().st_mode)


@pytest.mark.parametrize("is_dangling", [False, True])
def test_a_symbolic_link_is_written_through(tmp_path: Path, is_dangling: bool) -> None:
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "report.json", tmp_path / "link.json"
    if not is_dangling:
        target.write_text("old")
    link.symlink_to(Path("there") / "report.json")
    with replace_file(link) as partial:
        partial.write_text("new")
    assert link.is_symlink() and target.read_text() == "new"
    assert (names(tmp_path), names(tmp_path / "there")) == ({"there", "link.json"}, {"report.json"})


@pytest.mark.parametrize("number", [NO_PROCESS, os.getpid()], ids=["gone", "given to this one"])
def test_the_next_writer_removes_what_a_killed_process_left(tmp_path: Path, number: int) -> None:
    (tmp_path / f".report.json.{number}.partial").write_text("half")
    (tmp_path / f".made.{number}.partial").mkdir()
    (tmp_path / f".made.{number}.partial" / "a").write_text("half")
    (tmp_path / ".report.json.of mine.partial").write_text("mine")
    with replace_file(tmp_path / "report.json") as partial:
        partial.write_text("new")
    write_new_folder(tmp_path / "made", {"a": b"1"})
    assert names(tmp_path) == {"report.json", "made", ".report.json.of mine.partial"}
    assert names(tmp_path / "made") == {"a"}


def test_a_folder_of_ours_is_rid_of_everything_half_but_of_nothing_else(tmp_path: Path) -> None:
    for name in ("a.nc", "b.json", "c.d"):
        for kind in ("partial", "older", "newer"):
            (tmp_path / f".{name}.{NO_PROCESS}.{kind}").write_text("half")
    kept = {"a.nc", f".a.nc.{os.getpid()}.partial", f".a.nc.{NO_PROCESS}.other", f"a.nc.{NO_PROCESS}.partial"}
    for name in kept:
        (tmp_path / name).write_text("whole")
    remove_all_partials(tmp_path)
    remove_all_partials(tmp_path / "nowhere")
    assert names(tmp_path) == kept


FILES = {name: name.encode() * 10_000 for name in ("one.txt", "two.txt", "three.txt")}


@pytest.mark.parametrize("kind", ["folder", "empty folder", "file", "dangling link"])
def test_what_is_there_is_never_overwritten_and_no_parent_is_made(kind: str, tmp_path: Path) -> None:
    target = tmp_path / "old"
    if kind == "file":
        target.write_text("mine")
    elif kind == "dangling link":
        target.symlink_to(tmp_path / "nowhere")
    else:
        target.mkdir()
        if kind == "folder":
            (target / "mine").write_text("mine")
    with pytest.raises(FolderError, match="old: exists already and is not overwritten"):
        write_new_folder(target, FILES)
    with pytest.raises(FolderError, match="nowhere: no such folder"):
        write_new_folder(tmp_path / "nowhere" / "new", FILES)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


def test_at_every_instant_the_folder_is_whole_or_not_there(tmp_path: Path) -> None:
    """What a killed writer leaves is what there is between two of its lines."""
    folder, seen = tmp_path / "new", list[dict[str, bytes] | None]()

    def look(*_: object) -> Callable[..., Any]:
        is_there = os.path.lexists(folder)
        seen.append({path.name: path.read_bytes() for path in folder.iterdir()} if is_there else None)
        return look

    def trace(frame: FrameType, *_: object) -> Callable[..., Any] | None:
        return look if frame.f_code.co_filename == files.__file__ else None

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        write_new_folder(folder, FILES)
    finally:
        sys.settrace(before)
    assert seen == sorted(seen, key=bool) and seen.count(FILES) > 3 and seen.count(None) > 20
    assert all(each in (None, FILES) for each in seen)
