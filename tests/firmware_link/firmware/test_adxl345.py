"""The driver of the ADXL345 against the part by its registers: found, set up, and read a byte a turn."""

import ctypes

import numpy as np
import pytest

from tests.firmware_link.firmware.compiled_core import core_library

TURNS = 7
# Measuring at 3200 Hz in full resolution and 16 g, data ready on INT1.
WANTED = {0x2C: 0x0F, 0x2D: 0x08, 0x2E: 0x80, 0x2F: 0x00, 0x31: 0x0B}


class Part:
    """A model of the part, with the glue of a board."""

    def __init__(self, *, is_there: bool = True) -> None:
        self.library = core_library()
        for name in ("adxl345_model_start", "adxl345_model_turn"):
            getattr(self.library, name).restype = ctypes.c_bool
        self.library.adxl345_model_register.restype = ctypes.c_uint8
        self.library.adxl345_model_reset(ctypes.c_bool(is_there))

    def start(self) -> bool:
        return bool(self.library.adxl345_model_start())

    def turn(self) -> int | None:
        value = ctypes.c_int16()
        return value.value if self.library.adxl345_model_turn(ctypes.byref(value)) else None

    def sample(self, x: int, y: int, z: int) -> None:
        self.library.adxl345_model_sample(*map(ctypes.c_int16, (x, y, z)))


def test_a_part_is_found_where_it_is_and_set_up() -> None:
    assert not Part(is_there=False).start()
    part = Part()
    assert part.start()
    assert {address: part.library.adxl345_model_register(address) for address in WANTED} == WANTED
    assert part.library.adxl345_model_faults() == 0


def test_every_sample_is_read_in_a_byte_a_turn_and_once() -> None:
    part = Part()
    part.start()
    for x, y, z in np.random.default_rng(1).integers(-4_300, 4_300, (200, 3)).tolist():
        assert part.turn() is None
        part.sample(x, y, z)
        read = [part.turn() for _ in range(TURNS + 1)]
        assert read[:TURNS] == [None] * TURNS
        assert read[TURNS] == max(-4_096, min(4_095, z)) // 2 * 2
    assert part.library.adxl345_model_faults() == 0


@pytest.mark.parametrize("turns", [8, 15, 40])
def test_a_board_that_turns_often_enough_misses_none(turns: int) -> None:
    """15 turns of 48 kHz come between two samples at 3.2 kHz."""
    part, got = Part(), []
    part.start()
    for z in range(0, 400, 2):
        part.sample(0, 0, z)
        got += [value for value in (part.turn() for _ in range(turns)) if value is not None]
    assert got == list(range(0, 400, 2))
