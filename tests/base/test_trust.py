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


def name_group(monkeypatch: pytest.MonkeyPatch, name: str, *members: str) -> None:
    """Every group is called so and has these members."""
    monkeypatch.setattr(grp, "getgrgid", lambda _: SimpleNamespace(gr_name=name, gr_mem=list(members)))


@pytest.mark.parametrize("mode", [0o777, 0o702, 0o770])
@pytest.mark.parametrize("level", [0, 1, 2], ids=["file", "folder", "folder above"])
def test_a_part_that_others_can_write_is_named(
    kept: Path, mode: int, level: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    name_group(monkeypatch, "staff")
    part = [kept, *kept.parents][level]
    part.chmod(mode)
    assert open_to_others(kept) == part


@pytest.mark.parametrize(("members", "mode", "is_trusted"), [
    ((), 0o770, True),
    ((USER,), 0o770, True),
    ((USER, "another"), 0o770, False),
    ((), 0o777, False),
])  # fmt: skip
def test_the_group_of_one_user_s_own_name_is_that_user(
    kept: Path, members: tuple[str, ...], mode: int, is_trusted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the umask is 002, every folder is such a group's."""
    name_group(monkeypatch, USER, *members)
    kept.parent.chmod(mode)
    assert (open_to_others(kept) is None) == is_trusted


def test_of_a_sticky_folder_what_lies_in_it_is_trusted_and_not_the_folder(kept: Path) -> None:
    kept.parent.chmod(0o1777)
    assert open_to_others(kept) is None
    assert open_to_others(kept.parent) == kept.parent


def test_what_belongs_to_root_is_trusted() -> None:
    assert open_to_others(Path("/usr/bin"), os.getuid() + 1) is None


def test_what_belongs_to_another_user_is_not_trusted(kept: Path) -> None:
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


def test_a_link_to_itself_is_not_trusted(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("link")
    assert open_to_others(tmp_path / "link" / "kept") == tmp_path / "link"
