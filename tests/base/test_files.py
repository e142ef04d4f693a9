"""Laws of files that are whole or not there, and of temporary folders that go with their process."""

import contextlib
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from base import files
from base.files import (
    FolderError,
    WriteError,
    remove_abandoned,
    remove_all_partials,
    remove_partials,
    replace_file,
    work_folder,
    write_new_folder,
)
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


WAITS = """
import sys
from pathlib import Path
from base import files
files.MEMORY = Path(sys.argv[1])
with files.work_folder("test", in_memory=True) as folder:
    (folder / "ring").write_text("content")
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of /dev/shm, and one in that of /tmp."""
    for name in ("memory", "disk"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(files, "MEMORY", tmp_path / "memory")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "disk"))
    return tmp_path / "memory"


def test_it_is_only_its_users_and_goes_with_its_block(memory: Path) -> None:
    for in_memory, parent in ((True, memory), (False, memory.parent / "disk")):
        with work_folder("test", in_memory=in_memory) as folder:
            assert folder.parent == parent and folder.name.startswith("tactable-work-test-")
            assert folder.stat().st_mode & 0o777 == 0o700
            (folder / "file").write_text("content")
        assert not folder.exists()


@pytest.mark.machine(stall_s=None)
def test_what_a_killed_process_left_goes_when_the_next_folder_is_made(memory: Path) -> None:
    command = [sys.executable, "-c", WAITS, str(memory)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        left = Path(process.stdout.readline().strip())
        with work_folder("another"):
            assert (left / "ring").exists()
        process.kill()
        process.communicate()
    assert (left / "ring").exists()
    with work_folder("another"):
        assert not left.exists()


def test_a_folder_is_left_alone_while_it_is_locked_and_goes_when_it_is_not_and_nothing_else_goes(memory: Path) -> None:
    (memory / "tactable-work-test-gone" / "ring").mkdir(parents=True)
    (memory / "tactable-0").mkdir()
    (memory / "tactable-work-file").write_text("mine")
    (memory / "tactable-work-link").symlink_to(memory / "tactable-0")
    with work_folder("test", in_memory=True) as folder, work_folder("another", in_memory=True):
        remove_abandoned(memory)
        assert folder.is_dir()
    remove_abandoned(memory / "nowhere")
    assert {path.name for path in memory.iterdir()} == {"tactable-0", "tactable-work-file", "tactable-work-link"}


@pytest.mark.usefixtures("memory")
def test_a_folder_taken_for_abandoned_before_it_was_locked_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it was opened, and between that and the lock."""
    made, open_it = list[Path](), files._opened

    def open_and_lose(folder: Path) -> int:
        made.append(folder)
        if len(made) == 1:
            shutil.rmtree(folder)
        lock = open_it(folder)
        if len(made) == 2:
            shutil.rmtree(folder)
        return lock

    monkeypatch.setattr(files, "_opened", open_and_lose)
    with work_folder("test", in_memory=True) as folder:
        assert len(made) == 3 and folder == made[-1] and folder.is_dir()
