"""Laws of work folders: they go with their process, however it ends, at the latest when another one makes its own."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from base import work_folder as module
from base.work_folder import remove_abandoned, work_folder

WAITS = """
import sys
from pathlib import Path
from base import work_folder
work_folder.MEMORY = Path(sys.argv[1])
with work_folder.work_folder("test", in_memory=True) as folder:
    (folder / "ring").write_text("content")
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of /dev/shm, and one in that of /tmp."""
    for name in ("memory", "disk"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(module, "MEMORY", tmp_path / "memory")
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


def test_a_folder_taken_for_abandoned_before_it_was_locked_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it was opened, and between that and the lock."""
    made, open_it = list[Path](), module._opened

    def open_and_lose(folder: Path) -> int:
        made.append(folder)
        if len(made) == 1:
            shutil.rmtree(folder)
        lock = open_it(folder)
        if len(made) == 2:
            shutil.rmtree(folder)
        return lock

    monkeypatch.setattr(module, "_opened", open_and_lose)
    with work_folder("test", in_memory=True) as folder:
        assert len(made) == 3 and folder == made[-1] and folder.is_dir()
