"""The address that people open: when there is a browser, what is told, and what is the report instead."""

import asyncio
import stat
import webbrowser
from pathlib import Path

import pytest
import segno
from typer.testing import CliRunner

from engine.effects import Drives
from tactable.cli import demo as cli
from tactable.cli.main import app
from tactable.control.security import AccessPolicy
from tactable.page import opening
from tactable.page.opening import announcement, has_browser, qr_code, reachable, token_for
from tactable.page.processes.programs import ProgramsAt
from tests.tactable.page.test_server import Notes

SCREEN = {"DISPLAY": ":0"}


@pytest.fixture
def reported(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The figures of the reports that were asked for; none is made."""
    figures: list[Path] = []

    def report(
        _device: object, _recording: object, _table: object, _effects: object, figure: Path, _json: bool
    ) -> None:
        figures.append(figure)

    monkeypatch.setattr(cli, "report_demo", report)
    return figures


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[opening.Address]:
    """Where pages were asked for; none is served."""
    addresses: list[opening.Address] = []

    def show(
        _name: str, _device: object, _rules: object, _cache: Path, address: opening.Address, *_more: object
    ) -> None:
        addresses.append(address)

    monkeypatch.setattr(opening, "show_demo", show)
    return addresses


def demo(*words: str) -> str:
    found = CliRunner().invoke(app, ["demo", *words])
    assert found.exception is None or isinstance(found.exception, SystemExit), found.exception
    return found.output


def test_a_browser_needs_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webbrowser, "get", lambda: webbrowser.GenericBrowser("true"))
    assert not has_browser({})
    assert has_browser(SCREEN)
    assert has_browser({"WAYLAND_DISPLAY": "wayland-0"})


def test_a_screen_without_a_browser_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> webbrowser.BaseBrowser:
        raise webbrowser.Error("none")

    monkeypatch.setattr(webbrowser, "get", none)
    assert not has_browser(SCREEN)


@pytest.mark.parametrize(
    "words", [("--headless",), ("--json",), ("--figure", "demo.png"), ("--recording", "a.hid"), ("--table", "a.nc")]
)
def test_what_asks_for_the_report_opens_no_page(
    words: tuple[str, ...], shown: list[opening.Address], reported: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "has_browser", lambda: True)
    demo(*words)
    assert (len(reported), shown) == (1, [])


def test_without_a_browser_it_is_the_report_and_says_so(
    shown: list[opening.Address], reported: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "has_browser", lambda: False)
    demo()
    assert (reported, shown) == ([Path("tactable-demo.png")], [])


def test_with_a_browser_it_is_the_page_on_loopback(
    shown: list[opening.Address], reported: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "has_browser", lambda: True)
    demo()
    assert (shown, reported) == ([opening.Address("127.0.0.1", 0, opens_browser=True)], [])


@pytest.mark.parametrize(
    ("words", "address"),
    [
        (("--no-open",), opening.Address()),
        (("--host", "0.0.0.0"), opening.Address("0.0.0.0")),
        (("--page-port", "8123"), opening.Address(port=8123)),
    ],
)
def test_a_page_that_is_asked_for_needs_no_browser(
    words: tuple[str, ...],
    address: opening.Address,
    shown: list[opening.Address],
    reported: list[Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(opening, "has_browser", lambda: False)
    demo(*words)
    assert [(found.host, found.port) for found in shown] == [(address.host, address.port)]
    assert not shown[0].opens_browser
    assert reported == []


def test_a_control_channel_is_the_page_s_and_stands_where_it_was_asked_for(
    reported: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(opening, "has_browser", lambda: False)
    monkeypatch.setattr(opening, "show_demo", lambda *values: asked.append(values[-1]))
    demo("--control", "--control-socket", "/tmp/some.sock", "--control-port", "0")
    demo("--no-open")
    assert asked == [ProgramsAt("/tmp/some.sock", 0, None), None] and reported == []
    assert "--control are the page's" in demo("--control", "--headless")


def test_the_page_begins_with_the_drives_that_were_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr(opening, "show_demo", lambda *values: asked.append(values[-2]))
    for words in (("--drives", "zones"), ()):
        demo("--no-open", *words)
    assert asked == [Drives.ZONES, None]
    found = CliRunner().invoke(
        app, ["demo", "--no-open", "--drives", "zones", "--effects", str(tmp_path / "rules.toml")]
    )
    assert "its key `drives`" in str(found.exception)


def test_a_report_and_a_page_are_not_asked_for_at_once(shown: list[opening.Address], reported: list[Path]) -> None:
    demo("--headless", "--no-open")
    assert (shown, reported) == ([], [])


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


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "192.0.2.7", "localhost"])
def test_a_page_that_is_bound_to_one_address_is_reached_there(host: str) -> None:
    assert reachable(host) == host


def test_the_token_of_a_stated_port_is_kept_for_its_user_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert token_for(0) != token_for(0)
    assert token_for(8123) == token_for(8123)
    (kept,) = (tmp_path / "tactable").iterdir()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600


def test_a_kept_token_that_others_could_have_written_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    planted = token_for(8123)
    tmp_path.chmod(0o777)
    assert token_for(8123) != planted


@pytest.mark.parametrize("damaged", ["", "\n", "a b", "\N{GREEK SMALL LETTER ALPHA}" * 32])
def test_a_damaged_token_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damaged: str) -> None:
    """A disk that was full when it was written locked everybody out."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = tmp_path / "tactable" / "page-token"
    kept.parent.mkdir()
    kept.write_text(damaged, encoding="utf-8")
    token = token_for(8123)
    assert len(token) >= 32
    assert token_for(8123) == kept.read_text(encoding="utf-8") == token
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
