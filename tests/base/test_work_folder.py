"""Laws of work folders: they go with their process, however it ends, at the latest when another one makes its own."""

import shutil
import subprocess
import sys
import tempfile
import threading
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


def test_a_folder_is_left_alone_as_long_as_it_is_locked_and_goes_when_it_is_not(memory: Path) -> None:
    abandoned = memory / "tactable-work-test-gone"
    (abandoned / "ring").mkdir(parents=True)
    with work_folder("test", in_memory=True) as folder, work_folder("another", in_memory=True):
        remove_abandoned(memory)
        assert folder.is_dir() and not abandoned.exists()


def test_nothing_else_is_removed(memory: Path) -> None:
    (memory / "tactable-0").mkdir()
    (memory / "tactable-work-file").write_text("mine")
    (memory / "tactable-work-link").symlink_to(memory / "tactable-0")
    remove_abandoned(memory)
    assert len(list(memory.iterdir())) == 3
    remove_abandoned(memory / "nowhere")


def test_a_folder_that_was_taken_for_abandoned_before_it_was_locked_is_made_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = list[str]()
    make = tempfile.mkdtemp

    def make_and_lose(**words: str) -> str:
        made.append(make(**words))
        if len(made) < 3:
            shutil.rmtree(made[-1])
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", make_and_lose)
    with work_folder("test", in_memory=True) as folder:
        assert len(made) == 3 and str(folder) == made[-1] and folder.is_dir()


def test_makers_and_removers_at_the_same_time_take_nothing_from_each_other(memory: Path) -> None:
    lost = list[Path]()

    def make_often() -> None:
        for _ in range(100):
            with work_folder("test", in_memory=True) as folder:
                if not folder.is_dir():
                    lost.append(folder)

    threads = [threading.Thread(target=make_often) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert lost == [] and list(memory.iterdir()) == []
