"""The C headers of the firmware are those that would be made now."""

from firmware_link.codegen import c_header
from firmware_link.codegen import sine_table as c_sine_table


def test_the_protocol_header_is_that_of_the_messages() -> None:
    assert c_header.HEADER.read_text(encoding="ascii") == c_header.build_header()


def test_the_sine_table_is_that_of_its_formula() -> None:
    assert c_sine_table.HEADER.read_text(encoding="ascii") == c_sine_table.build_header()
