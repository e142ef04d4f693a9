"""The vectors of the repository are what this code makes of them, and speak of every message."""

import pytest

from firmware_link.protocol.bank import decode_bank, encode_bank, hash_of_bank
from firmware_link.protocol.framing import FrameDecoder
from firmware_link.protocol.messages import MESSAGES, decode_body
from tests.firmware_link.codegen.vectors import FOLDER, example_bank, example_messages, vector_files


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


def test_the_bank_decodes_to_its_waveforms() -> None:
    _, data, bank_hash = lines_of("bank.txt")[0].split(" | ")
    bank = decode_bank(bytes.fromhex(data), 2)
    assert encode_bank(bank, 2) == encode_bank(example_bank(), 2)
    assert hash_of_bank(bytes.fromhex(data)) == int(bank_hash, 16)
