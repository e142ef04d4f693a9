"""Text that a terminal shows and does not obey."""

import re
import sys

# Control characters but for tab and line feed, marks that change the direction of text, and halves of a character.
_COMMANDING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """The text with U+FFFD for each character that would command a terminal instead of being shown.

    Names come from USB devices, recordings and the files of others: an escape code in one could retitle the window,
    hide lines or type an answer.
    """
    return _COMMANDING.sub("\N{REPLACEMENT CHARACTER}", text)


def write_note(text: str) -> None:
    """Write what a user should know as a line on standard error, from any process of ours."""
    sys.stderr.write(f"note: {printable(text)}\n")
    sys.stderr.flush()
