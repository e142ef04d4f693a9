"""Laws of trust in a path: whoever can replace a part of the way to a file can replace the file."""

import grp
import os
import pwd
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from base.trust import open_to_others

USER = pwd.getpwuid(os.getuid()).pw_name


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
