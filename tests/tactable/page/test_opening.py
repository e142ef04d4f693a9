"""The address that people open: when there is a browser, what is told, and what is the report instead."""

import asyncio
import stat
import webbrowser
from pathlib import Path
from typing import Any

import pytest
import segno
from typer.testing import CliRunner

from engine.effects.rules import Drives
from tactable.cli import demo as cli
from tactable.cli.main import app
from tactable.control.security import AccessPolicy
from tactable.page import opening
from tactable.page.opening import announcement, has_browser, qr_code, reachable, token_for
from tactable.page.processes.engine_process import ProgramsAt
from tests.tactable.page.test_page_server import Notes

SCREEN = {"DISPLAY": ":0"}


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What was asked for, in order: values of a report, or those of a page.

    Nothing is made or served. The last two of a page are its drives, and where its control channel is.
    """
    asked: list[Any] = []
    for module, name in ((cli, "report_demo"), (opening, "show_demo")):
        monkeypatch.setattr(module, name, lambda *values: asked.append(values))
    return asked


def demo(*words: str) -> str:
    found = CliRunner().invoke(app, ["demo", *words])
    return f"{found.output} {found.exception}"


def test_a_browser_needs_a_screen_and_a_screen_a_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> webbrowser.BaseBrowser:
        raise webbrowser.Error("none")

    monkeypatch.setattr(webbrowser, "get", lambda: webbrowser.GenericBrowser("true"))
    assert [has_browser(screen) for screen in ({}, SCREEN, {"WAYLAND_DISPLAY": "wayland-0"})] == [False, True, True]
    monkeypatch.setattr(webbrowser, "get", none)
    assert not has_browser(SCREEN)


@pytest.mark.parametrize("has_one", [True, False])
def test_the_demo_is_the_page_where_there_is_a_browser_or_it_is_asked_for_and_else_the_report(
    has_one: bool, opened: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "has_browser", lambda: has_one)
    figure = Path("tactable-demo.png")
    for words, expected in (
        ((), opening.Address("127.0.0.1", 0, opens_browser=True) if has_one else figure),
        (("--no-open",), opening.Address(opens_browser=False)),
        (("--host", "0.0.0.0"), opening.Address("0.0.0.0", opens_browser=False)),
        (("--page-port", "8123"), opening.Address(port=8123, opens_browser=has_one)),
        (("--headless",), figure),
        (("--json",), figure),
        (("--figure", "other.png"), Path("other.png")),
        (("--recording", "a.hid"), figure),
        (("--table", "a.nc"), figure),
    ):
        demo(*words)
        assert [expected in values for values in opened] == [True], words
        opened.clear()


def test_drives_and_a_control_channel_are_the_page_s_as_they_were_asked_for(opened: list[Any]) -> None:
    demo("--control", "--control-socket", "/tmp/some.sock", "--control-port", "0")
    demo("--no-open", "--drives", "zones")
    for words in (("--no-open",), ("--control",)):
        assert "--control are the page's" in demo("--headless", *words)
    assert "its key `drives`" in demo("--no-open", "--drives", "zones", "--rules", "rules.toml")
    assert [values[-2:] for values in opened] == [(None, ProgramsAt("/tmp/some.sock", 0, None)), (Drives.ZONES, None)]


@pytest.mark.usefixtures("both_ends")
def test_the_command_line_of_the_browser_holds_no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    class OpenedError(Exception):
        pass

    def note(url: str) -> None:
        said.append(url)
        raise OpenedError

    said: list[str] = []
    monkeypatch.setattr(webbrowser, "open", note)
    with pytest.raises(OpenedError):
        asyncio.run(opening._serve(Notes(), opening.Address(), said.append))
    printed, opened = said
    token = printed.split("/")[3]
    assert len(token) >= 32 and token not in opened and opened.startswith("http://127.0.0.1:")


@pytest.mark.usefixtures("both_ends")
def test_only_a_page_that_others_reach_has_a_warning() -> None:
    (line,) = announcement(AccessPolicy("127.0.0.1", 8000, "secret"))
    assert "http://127.0.0.1:8000/secret/" in line
    assert [reachable(host) for host in ("::1", "192.0.2.7", "localhost")] == ["::1", "192.0.2.7", "localhost"]
    own = reachable("0.0.0.0")
    address, warning, words, *code = announcement(AccessPolicy("0.0.0.0", 8000, "secret"))
    assert own != "0.0.0.0" and f"http://{own}:8000/secret/" in address
    assert "WARNING" in warning and "phone" in words
    assert not any("secret" in line for line in (warning, words, *code))
    assert code == qr_code(f"http://{own}:8000/secret/")


def test_a_qr_code_has_its_modules_two_to_a_character() -> None:
    text = "http://192.0.2.7:8000/secret/"
    halves = {" ": (1, 1), "▀": (0, 1), "▄": (1, 0), "█": (0, 0)}
    lines = [[halves[each] for each in line] for line in qr_code(text)]
    rows = [[each[half] for each in line] for line in lines for half in (0, 1)]
    wanted = [list(row) for row in segno.make(text, micro=False).matrix_iter(border=2)]
    assert rows[: len(wanted)] == wanted
    assert all(len(line) <= 80 for line in lines)


def test_the_token_of_a_stated_port_is_kept_for_its_user_alone_and_not_believed_where_others_could_have_written_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert token_for(0) != token_for(0)
    planted = token_for(8123)
    assert token_for(8123) == planted
    (kept,) = (tmp_path / "tactable").iterdir()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    for damaged in ("", "\n", "a b", "\N{GREEK SMALL LETTER ALPHA}" * 32):  # such as by a disk that was full
        kept.write_text(damaged, encoding="utf-8")
        token = token_for(8123)
        assert len(token) >= 32
        assert token_for(8123) == kept.read_text(encoding="utf-8") == token
        assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    tmp_path.chmod(0o777)
    assert token_for(8123) != token
