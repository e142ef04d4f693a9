"""Every board builds without a warning, as far as a bare compiler can build it."""

from pathlib import Path

import pytest

from tests.firmware_link.firmware.compiled_core import make, need

IMAGES = ("mps2_an385.elf", "mps2_four.elf", "stm32f405.elf", "stm32f405_qemu.elf")


@pytest.mark.long
def test_all_boards_build_without_a_warning(tmp_path: Path) -> None:
    need("make", "cc", "arm-none-eabi-gcc", "arm-none-eabi-g++")
    make(tmp_path, "check")
    assert all((tmp_path / image).is_file() for image in IMAGES)
