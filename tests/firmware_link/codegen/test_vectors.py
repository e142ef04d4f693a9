"""The vectors of the repository are what this code makes of them, and speak of every message."""

import pytest

from firmware_link.protocol.basis import decode_basis, encode_basis, hash_of_basis
from firmware_link.protocol.framing import FrameDecoder
from firmware_link.protocol.messages import MESSAGES, decode_body
from tests.firmware_link.codegen.vectors import FOLDER, example_basis, example_messages, vector_files


def lines_of(name: str) -> list[str]:
    lines = (FOLDER / name).read_text(encoding="ascii").splitlines()
    return [line for line in lines if not line.startswith("#")]


@pytest.mark.parametrize("name", vector_files())
def test_the_files_are_those_that_would_be_made(name: str) -> None:
    assert lines_of(name) == vector_files()[name]


def test_every_message_has_a_vector_and_its_frame_decodes_to_it() -> None:
    decoder, names = FrameDecoder(2), set()
    for line, message in zip(lines_of("messages.txt"), example_messages(), strict=True):
        name, _, body, frame = line.split(" | ")
        names.add(name)
        assert decoder.receive(bytes.fromhex(frame)) == [bytes.fromhex(body)]
        assert decode_body(bytes.fromhex(body))[1] == message
    assert names == {message.wire_name for message in MESSAGES}


def test_the_basis_decodes_to_its_functions() -> None:
    _, data, basis_hash = lines_of("basis.txt")[0].split(" | ")
    basis = decode_basis(bytes.fromhex(data), 2)
    assert encode_basis(basis) == example_basis().data
    assert hash_of_basis(bytes.fromhex(data)) == int(basis_hash, 16)
