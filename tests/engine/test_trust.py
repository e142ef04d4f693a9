"""Laws of trust in a path: whoever can replace a part of the way to a file can replace the file."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from engine.trust import open_to_others


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


@pytest.mark.parametrize("mode", [0o777, 0o702, 0o770])
@pytest.mark.parametrize("level", [0, 1, 2], ids=["file", "folder", "folder above"])
def test_a_part_that_others_can_write_is_named(
    kept: Path, mode: int, level: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("engine.trust._is_private_group", lambda *_: False)
    part = [kept, *kept.parents][level]
    part.chmod(mode)
    assert open_to_others(kept) == part


def test_of_a_sticky_folder_what_lies_in_it_is_trusted_and_not_the_folder(kept: Path) -> None:
    kept.parent.chmod(0o1777)
    assert open_to_others(kept) is None
    assert open_to_others(kept.parent) == kept.parent


def test_what_belongs_to_another_user_is_not_trusted_and_what_is_root_s_is(kept: Path) -> None:
    assert open_to_others(Path("/usr"), os.getuid() + 1) is None
    os.chown(kept, kept.stat().st_uid, -1)
    found = open_to_others(kept, os.getuid() + 1)
    assert (found is None) == (os.getuid() == 0)  # what root made is root's
    if os.getuid() == 0:
        os.chown(kept.parent, 12345, -1)
        assert open_to_others(kept) == kept.parent


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


def test_a_link_to_itself_is_not_trusted(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("link")
    assert open_to_others(tmp_path / "link" / "kept") == tmp_path / "link"
