"""The pages in docs/ do what they say: every command, every snippet, every link."""

import json
import os
import re
import shutil
from pathlib import Path

import pytest

from engine.device import DeviceError
from tactable import Device, build_table
from tests.documents import (
    ROOT,
    Block,
    Command,
    Page,
    check_command,
    is_alike,
    read_blocks,
    read_commands,
    relative_links,
)
from tests.small_device import small_text

PAGES = sorted((ROOT / "docs").rglob("*.md"))
DEAR = ("calibration.md", "figures.md", "first-hour.md", "fleet.md", "tables.md")
"""Pages that take long or need clicks: they are run with the long tests."""
LIVE = ("audio.md", "first-hour.md", "safety.md")
"""Pages with commands that play a device in a process of its own."""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of my-bar.toml as first-hour.md builds it, but without clicks, for the pages that come after."""
    folder = tmp_path_factory.mktemp("built")
    (folder / "my-bar.toml").write_text(small_text(), encoding="utf-8")
    build_table(Device.read(folder / "my-bar.toml"), folder / "my-bar.nc", clicks_up_to=0)
    return folder


@pytest.fixture(scope="module")
def built_with_clicks(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(shutil.copytree(built, tmp_path_factory.mktemp("built_with_clicks"), dirs_exist_ok=True))
    build_table(Device.read(folder / "my-bar.toml"), folder / "my-bar.nc", clicks_up_to=1)
    return folder


@pytest.fixture
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which a reader of the page `path` has a checkout and the table of first-hour.md."""
    needs_clicks = request.node.callspec.params["path"].name in DEAR and not request.node.get_closest_marker("machine")
    built: Path = request.getfixturevalue("built_with_clicks" if needs_clicks else "built")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})  # on one core nothing is solved by other processes
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in ("tables", "examples"):
        (folder / name).symlink_to(ROOT / name)
    for name in ("my-bar.toml", "my-bar.nc"):
        shutil.copy(built / name, folder / name)
    return folder


def run(path: Path, folder: Path, *, live: bool | None) -> None:
    with Page(folder, live=live) as page:
        for block in read_blocks(path):
            page.run(block)


@pytest.mark.parametrize(
    "path", [pytest.param(path, marks=[pytest.mark.long] if path.name in DEAR else [], id=path.name) for path in PAGES]
)
def test_every_command_and_snippet_runs(path: Path, folder: Path) -> None:
    """Those of the live pages that play a device have a test of their own."""
    run(path, folder, live=False if path.name in LIVE else None)


@pytest.mark.machine
@pytest.mark.parametrize("path", [ROOT / "docs" / name for name in LIVE], ids=LIVE)
def test_every_command_that_plays_a_device_runs(path: Path, folder: Path) -> None:
    run(path, folder, live=True)


@pytest.mark.parametrize("path", [ROOT / "README.md", *PAGES], ids=lambda path: path.name)
def test_every_link_leads_to_a_file(path: Path) -> None:
    assert [str(target) for target in relative_links(path) if not target.exists()] == []


def test_every_page_is_in_the_index() -> None:
    listed = {target.resolve() for target in relative_links(ROOT / "docs" / "README.md")}
    assert {path.resolve() for path in PAGES} <= {*listed, (ROOT / "docs" / "README.md").resolve()}


def known_keys() -> dict[str, set[str]]:
    """The keys of a description by section: those of the schema, which has the reader's (test_schemas.py)."""
    schema = json.loads((ROOT / "tables" / "schemas" / "device.schema.json").read_text(encoding="utf-8"))
    parts = {key: part.get("items", part) for key, part in schema["properties"].items()}
    parts |= {key: schema["$defs"][key] for key, part in parts.items() if "anyOf" in part}
    keys = {section: set(part["properties"]) for section, part in parts.items() if "properties" in part}
    table = '[actuator.electrodes]\nnumber = 1\nbias = "50 %"\nqqqqqq = 1\n[zones]'
    with pytest.raises(DeviceError, match="known keys are") as refused:
        Device.parse(small_text().replace("[zones]", table, 1), "my-bar.toml")
    keys["electrodes"] = set(str(refused.value).partition("known keys are ")[2].split(", "))
    keys[""] = parts.keys() - (keys.keys() - {"threshold"}) - {"calibration"}
    return {section: own - {"inferred"} for section, own in keys.items()}


def documented_keys() -> dict[str, list[str]]:
    """The keys in the first columns of devices.md, by section."""
    found: dict[str, list[str]] = {}
    section = ""
    for line in (ROOT / "docs" / "devices.md").read_text(encoding="utf-8").splitlines():
        if heading := re.match(r"##+ (?:`\[+(?:actuator\.)?(\w+)|At the top)", line):
            section = heading[1] or ""
        elif own := re.match(r"\| key of `\[+(\w+)", line):
            section = own[1]
        elif row := re.match(r"\| `(\w+)` \|", line):
            found.setdefault(section, []).append(row[1])
    return found


def test_the_page_about_devices_has_every_key_and_no_other() -> None:
    assert {section: set(keys) for section, keys in documented_keys().items()} == known_keys()


def test_a_block_of_a_console_is_its_commands_with_what_they_print() -> None:
    block = Block("page:1", "console", (), "$ tactable list \\\n  --json\n{}\n$ tactable list # exit status 1 or 3\n")
    first, second = read_commands(block)
    assert (first.words, first.expected, first.statuses) == (["tactable", "list", "--json"], "{}\n", {0})
    assert (second.words, second.expected, second.statuses) == (["tactable", "list"], None, {1, 3})


@pytest.mark.parametrize(
    ("expected", "fits"),
    [
        ("one\ntwo   2.5\nthree\n", True),
        ("one\n...\nthree\n", True),
        ("one\n...\ntwo ...\n...\nthree\n...\n", True),
        ("one\nthree\n", False),
        ("one\n...\ntwo 2.50\nthree", False),
        ("two 2.5\nthree", False),
        ("...\ntwo 2.5", False),
    ],
)
def test_an_ellipsis_stands_for_anything_and_nothing_else_does(expected: str, fits: bool) -> None:
    assert is_alike(expected, "one\ntwo 2.5\nthree\n") is fits


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("tactable lsit", "there is no command 'lsit'"),
        ("tactable plot", "names no command"),
        ("tactable run bar.nc --touch simulated", "Missing option '--port'"),
        ("tactable run bar.nc --touch simulated --port P --fro 3", "No such option: --fro"),
        ("tactable run bar.nc --touch simulated --port P --for long", "Invalid value for '--for'"),
    ],
)
def test_a_command_that_is_not_run_must_exist_all_the_same(line: str, complaint: str) -> None:
    with pytest.raises(AssertionError, match=complaint):
        check_command(Command(line, None))


@pytest.mark.parametrize(
    ("language", "text", "complaint"),
    [
        ("sh", "tactable explain nothing.nc --felt I", "exit status 1"),
        ("console", "$ tactable emulate --faults help\nnothing of the kind\n", "nothing of the kind"),
        ("pycon", ">>> 1 + 1\n3\n", "Expected"),
    ],
)
def test_a_block_that_does_something_else_is_found(language: str, text: str, complaint: str, tmp_path: Path) -> None:
    with Page(tmp_path) as page, pytest.raises(AssertionError, match=complaint):
        page.run(Block("page:1", language, (), text))
