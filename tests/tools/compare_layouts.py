"""Our layouts beside hid-tools', field by field; hid-tools is GPL and only compared with, never part of the product.

    python -m venv /tmp/hid-tools && /tmp/hid-tools/bin/pip install hid-tools
    PYTHONPATH=. /tmp/hid-tools/bin/python -m tests.tools.compare_layouts ../shared/recordings/touch/*.hid

Compares report, bit, size, usage and logical range of every field of every contact and frame. Exit status 1 when one
differs.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from engine.touch.descriptor import Surface, read_surfaces
from engine.touch.hid_items import Field
from engine.touch.sources.recording import read_recording

CONTACT_USAGES = {
    "x": 0x0001_0030,
    "y": 0x0001_0031,
    "tip": 0x000D_0042,
    "contact_id": 0x000D_0051,
    "in_range": 0x000D_0032,
    "confidence": 0x000D_0047,
    "pressure": 0x000D_0030,
    "width": 0x000D_0048,
    "height": 0x000D_0049,
}
FRAME_USAGES = {"contact_count": 0x000D_0054, "scan_time": 0x000D_0056}

Place = tuple[int, int, int]
Meaning = tuple[int | None, int, int]


def main(paths: list[Path]) -> int:
    """Print every difference and the number of fields compared."""
    hid: Any = importlib.import_module("hidtools.hid")
    compared = different = 0
    for path in paths:
        descriptor = read_recording(path).descriptor
        theirs = dict(their_fields(hid.ReportDescriptor.from_bytes(descriptor)))
        for surface in read_surfaces(descriptor):
            for name, place, meaning in our_fields(surface):
                compared += 1
                if theirs.get(place) != meaning:
                    different += 1
                    sys.stdout.write(f"{path.name}: {name} at {place}: {meaning}, hid-tools {theirs.get(place)}\n")
    sys.stdout.write(f"{compared} fields compared, {different} differ\n")
    return int(different > 0)


def our_fields(surface: Surface) -> Iterator[tuple[str, Place, Meaning]]:
    """Name, place and meaning of every field that the digitizer reads."""
    for report in surface.reports:
        owners = [(CONTACT_USAGES, contact) for contact in report.contacts]
        for usages, owner in (*owners, (FRAME_USAGES, report)):
            for name, usage in usages.items():
                field: Field | None = getattr(owner, name)
                if field is not None:
                    place = (field.report_id, field.bit, field.size_bits)
                    yield name, place, (usage, field.logical_minimum, field.logical_maximum)


def their_fields(descriptor: Any) -> Iterator[tuple[Place, Meaning]]:
    """The same of hid-tools, every element of an array by itself."""
    for report_id, report in descriptor.input_reports.items():
        for field in report.fields:
            for i in range(field.count):
                usage = field.usages[min(i, len(field.usages) - 1)] if field.usages else getattr(field, "usage", None)
                place = (max(report_id, 0), field.start + i * field.size, field.size)
                yield place, (usage, field.logical_min, field.logical_max)


if __name__ == "__main__":
    sys.exit(main([Path(word) for word in sys.argv[1:]]))
