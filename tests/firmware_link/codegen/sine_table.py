"""Quarter-wave sine table of the firmware, generated as a C header.

`python -m tests.firmware_link.codegen.sine_table` rewrites `firmware/core/sine_table.h`; a test compares the two.
"""

import math
from pathlib import Path

HEADER = Path(__file__).parents[3] / "firmware_link" / "firmware" / "core" / "sine_table.h"
INTERVALS = 256
# Full amplitude, 65535/65536 of the firmware's fixed-point one, then gives 32767 of 16-bit output, never 32768.
FULL_SCALE = 2**30 * 32_767 / 32_767.5

_BEGINNING = """\
/* A quarter of a sine, made by `python -m tests.firmware_link.codegen.sine_table`, not to be edited. */
#ifndef TACTABLE_SINE_TABLE_H
#define TACTABLE_SINE_TABLE_H

"""


def build_header() -> str:
    """Text of the header; both ends of the quarter are in the table, so that its last interval needs no exception."""
    values = [round(FULL_SCALE * math.sin(math.pi / 2 * index / INTERVALS)) for index in range(INTERVALS + 1)]
    rows = (" ".join(f"{value}," for value in values[at : at + 8]) for at in range(0, len(values), 8))
    return (
        f"{_BEGINNING}#define SINE_INTERVALS {INTERVALS}u\n#define SINE_QUARTER \\\n    "
        + " \\\n    ".join(rows)
        + "\n\n#endif\n"
    )


if __name__ == "__main__":
    HEADER.write_text(build_header(), encoding="ascii")
