"""The C headers and the vectors of the repository are those that would be made now, and speak of every message."""

from types import ModuleType

import pytest

from firmware_link.protocol.messages import MESSAGES
from tests.firmware_link.codegen import c_header, sine_table
from tests.firmware_link.codegen.vectors import FOLDER, example_messages, vector_files


@pytest.mark.parametrize("made", [c_header, sine_table])
def test_the_headers_are_those_of_the_messages_and_of_the_formula(made: ModuleType) -> None:
    assert made.HEADER.read_text(encoding="ascii") == made.build_header()


def test_the_vectors_are_those_that_would_be_made_and_every_message_has_one() -> None:
    for name, lines in vector_files().items():
        text = (FOLDER / name).read_text(encoding="ascii")
        assert [line for line in text.splitlines() if not line.startswith("#")] == lines
    assert {type(message) for message in example_messages()} == set(MESSAGES)
