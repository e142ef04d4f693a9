"""The modules of the C core include each other in one direction only."""

import re
from graphlib import TopologicalSorter

from tests.firmware_link.firmware.compiled_core import FIRMWARE

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
