"""Every board builds without a warning, as far as a bare compiler can build it."""

import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.firmware_link.firmware.compiled_core import FIRMWARE, make, need

CORE = FIRMWARE / "core"


def includes(module: str) -> set[str]:
    """Modules that a module's header and source include, itself left out."""
    texts = [path.read_text() for path in (CORE / f"{module}.h", CORE / f"{module}.c") if path.is_file()]
    return {name for text in texts for name in re.findall(r'#include "(\w+)\.h"', text)} - {module}


def test_the_modules_of_the_core_form_a_tree() -> None:
    modules = {path.stem for path in CORE.glob("*.[ch]")}
    order = list(TopologicalSorter({module: includes(module) for module in modules}).static_order())
    layers = ["state", "reports", "drive", "memory", "session", "device"]
    assert [name for name in order if name in layers] == layers


IMAGES = ("mps2_an385.elf", "mps2_four.elf", "stm32f405.elf", "stm32f405_qemu.elf")


@pytest.mark.long
def test_all_boards_build_without_a_warning(tmp_path: Path) -> None:
    need("make", "cc", "arm-none-eabi-gcc", "arm-none-eabi-g++")
    make(tmp_path, "check")
    assert all((tmp_path / image).is_file() for image in IMAGES)
