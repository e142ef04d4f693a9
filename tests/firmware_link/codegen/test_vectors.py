"""The vectors of the repository are what this code makes of them, and speak of every message."""

import pytest

from firmware_link.protocol.messages import MESSAGES
from tests.firmware_link.codegen.vectors import FOLDER, example_messages, vector_files


def lines_of(name: str) -> list[str]:
    lines = (FOLDER / name).read_text(encoding="ascii").splitlines()
    return [line for line in lines if not line.startswith("#")]


@pytest.mark.parametrize("name", vector_files())
def test_the_files_are_those_that_would_be_made(name: str) -> None:
    assert lines_of(name) == vector_files()[name]


def test_every_message_has_a_vector() -> None:
    assert {type(message) for message in example_messages()} == set(MESSAGES)
