"""Laws of the table before this one."""

import os
from pathlib import Path

import pytest

from engine.table import TableError
from engine.table.history import previous_of, remove_leftovers, replace_table, roll_back
from tests.tools.processes import NO_PROCESS


def put(path: Path, *texts: str, keep: bool = True) -> None:
    """One new table after the other takes its place."""
    for text in texts:
        path.with_name("new").write_text(text)
        replace_table(path.with_name("new"), path, keep=keep)


@pytest.fixture(params=[True, False], ids=["links", "no links"])
def path(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    if not request.param:

        def refuse(*_: object) -> None:
            raise OSError("no links here")

        monkeypatch.setattr(os, "link", refuse)
    return tmp_path / "bar.nc"


def texts(path: Path) -> dict[str, str]:
    return {kept.name: kept.read_text() for kept in path.parent.iterdir()}


def test_the_table_before_is_kept_and_no_older_one_nor_one_that_is_only_completed(path: Path) -> None:
    put(path, "1")
    assert texts(path) == {"bar.nc": "1"}
    put(path, "2", "3")
    assert texts(path) == {"bar.nc": "3", "bar.nc.previous": "2"}
    put(path, "3 and more", keep=False)
    assert texts(path) == {"bar.nc": "3 and more", "bar.nc.previous": "2"}


def test_behind_a_link_the_table_before_lies_beside_the_table(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "bar.nc", tmp_path / "link.nc"
    link.symlink_to(real)
    put(real, "1", "2")
    assert previous_of(link) == previous_of(real)
    roll_back(link)
    assert link.is_symlink() and texts(real) == {"bar.nc": "1", "bar.nc.previous": "2"}


def test_a_table_that_is_its_own_previous_one_leaves_nothing_behind(tmp_path: Path) -> None:
    """As after a kill between keeping a table and putting another in its place."""
    path = tmp_path / "bar.nc"
    put(path, "1")
    previous_of(path).hardlink_to(path)
    roll_back(path)
    assert texts(path) == {"bar.nc": "1", "bar.nc.previous": "1"}
    put(path, "2")
    assert texts(path) == {"bar.nc": "2", "bar.nc.previous": "1"}


def test_rolled_back_twice_is_as_before_and_what_a_killed_one_left_is_removed(path: Path) -> None:
    put(path, "1", "2")
    for kind in ("older", "newer"):
        path.with_name(f".bar.nc.{NO_PROCESS}.{kind}").write_text("half")
    roll_back(path)
    assert texts(path) == {"bar.nc": "1", "bar.nc.previous": "2"}
    roll_back(path)
    assert texts(path) == {"bar.nc": "2", "bar.nc.previous": "1"}
    path.unlink()  # one that was lost is put back, too
    roll_back(path)
    assert texts(path)["bar.nc"] == "1"


def test_without_a_previous_table_there_is_nothing_to_put_back_and_a_folder_is_no_table(path: Path) -> None:
    """An empty name is the present folder."""
    put(path, "1")
    for wrong, says in ((path, "there is no previous table"), (path.parent, "is a folder"), (Path(), "is a folder")):
        with pytest.raises(TableError, match=says):
            roll_back(wrong)
    assert texts(path) == {"bar.nc": "1"}


def test_only_what_dead_processes_left_is_removed(tmp_path: Path) -> None:
    kept = {f".bar.nc.{os.getpid()}.partial", ".bar.nc.clicks", ".other.nc.1.partial"}
    for name in (f".bar.nc.{NO_PROCESS}.partial", f".bar.nc.{NO_PROCESS}.newer", *kept):
        (tmp_path / name).touch()
    remove_leftovers(tmp_path / "bar.nc")
    assert {path.name for path in tmp_path.iterdir()} == kept
