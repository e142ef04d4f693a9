"""What reaches a terminal commands nothing."""

import pytest

from base.printable import printable


@pytest.mark.parametrize("code", ["\x1b", "\x07", "\r", "\x08", "\x00", "\x7f", "\x9b", "\u202e", "\u2066", "\udc80"])
def test_what_would_command_a_terminal_is_replaced(code: str) -> None:
    assert printable(f"a{code}b") == "a\N{REPLACEMENT CHARACTER}b"


@pytest.mark.parametrize("text", ["", "Bar 3, µm ± 4\tx\n", "指 ü\u00a0é\u202f10"])
def test_what_is_only_shown_stays(text: str) -> None:
    assert printable(text) == text
