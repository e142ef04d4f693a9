"""Table of messages in PROTOCOL.md.

`python -m tests.firmware_link.codegen.protocol_table` rewrites it; a test compares.
"""

from pathlib import Path

from firmware_link.protocol.layout import Layout
from firmware_link.protocol.messages import MESSAGES

DOCUMENT = Path(__file__).parents[3] / "firmware_link" / "PROTOCOL.md"
BEGINNING, END = "<!-- made by protocol_table() -->\n", "<!-- end -->"


def protocol_table() -> str:
    """The table in Markdown."""
    rows = [
        "| type | message | sender | body bytes | fields after type and sequence | purpose |",
        "|---|---|---|---|---|---|",
    ]
    for layout in map(Layout, MESSAGES):
        message, each = layout.message, layout.length(1) - layout.length(0)
        count = "N" if layout.most is None else layout.words[-1][0]
        size = f"{layout.length(0)} + {each} {count}" if each else f"{layout.length(0)}"
        names = "<br>".join(f"`{text}`" for text in layout.field_texts())
        row = (f"0x{message.type_byte:02x}", message.wire_name, message.sender, size, names, message.purpose())
        rows.append(f"| {' | '.join(row)} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    before, _, rest = DOCUMENT.read_text(encoding="utf-8").partition(BEGINNING)
    DOCUMENT.write_text(before + BEGINNING + protocol_table() + END + rest.partition(END)[2], encoding="utf-8")
