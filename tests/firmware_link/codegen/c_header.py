"""C header of the firmware, generated from the messages: values, layouts, and functions that read and write bodies.

`python -m tests.firmware_link.codegen.c_header` rewrites `firmware/core/tactable_protocol.h`; a test compares the two.
"""

import re
from enum import Enum, IntFlag
from pathlib import Path

from firmware_link.protocol import framing, messages
from firmware_link.protocol.layout import Layout, Sender, Word

HEADER = Path(__file__).parents[3] / "firmware_link" / "firmware" / "core" / "tactable_protocol.h"

_ENUMS: tuple[type[Enum], ...] = tuple(
    value
    for value in vars(messages).values()
    if isinstance(value, type) and issubclass(value, Enum) and value.__module__ == messages.__name__
)
_OF_MESSAGES = (
    *("VERSION_MAJOR", "VERSION_MINOR", "MAGIC", "SCHEMA_HASH", "FULL_SCALE_WORD"),
    *("CLOCK_REFERENCE_US", "CLOCK_REFERENCE_SPAN", "BASIS_CHUNK_SIZE", "MAXIMUM_WEIGHTS", "MAXIMUM_FRACTION_BITS"),
    *("MAXIMUM_SENSED_VALUES", "LONGEST_SENSE_MS", "ACCELEROMETER", "LINEARISES"),
)
_CONSTANTS = {
    **{name: int(getattr(messages, name)) for name in _OF_MESSAGES},
    "EMERGENCY_STOP_RUN": framing.EMERGENCY_STOP_RUN,
}
_BEGINNING = """\
/* The wire in C: made from firmware_link/protocol/messages.py by
 * `python -m tests.firmware_link.codegen.c_header`, not to be edited.
 *
 * A reader returns false for a value whose meaning is unknown, and leaves blocks of bytes where they are in the body;
 * a writer returns the end of what it wrote.
 */
#ifndef TACTABLE_PROTOCOL_H
#define TACTABLE_PROTOCOL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "bytes.h"
"""
_END = "\n#endif\n"


def build_header() -> str:
    """Text of the header; deterministic."""
    layouts = [Layout(message) for message in messages.MESSAGES]
    constants = "".join(f"#define TACTABLE_{name} {value:#x}u\n" for name, value in _CONSTANTS.items())
    parts = [constants, *map(_enum_text, _ENUMS), _layouts_text(layouts), *map(_message_text, layouts)]
    return _BEGINNING + "".join(f"\n{part}" for part in parts) + _END


def _enum_text(kind: type[Enum]) -> str:
    name = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()  # in snake case
    members = "".join(f"    TACTABLE_{name.upper()}_{member.name} = {member.value},\n" for member in kind)
    sentence = (kind.__doc__ or "").partition("\n")[0]
    return f"/* {sentence} */\nenum tactable_{name} {{\n{members}}};\n"


def _layouts_text(layouts: list[Layout]) -> str:
    rows = ", \\\n".join(
        f"    {{{layout.seed:#010x}u, {layout.length(0)}u, {_each(layout)}u, {layout.most or 0}u, "
        f"{layout.message.type_byte:#04x}u}}"
        for layout in layouts
    )
    sent = [layout for layout in layouts if layout.message.sender is not Sender.HOST]
    return (
        "/* How frames of one type are checked: the seed of their CRC and the length of their bodies. `length_each`\n"
        " * comes once for each actuator or, where `most` is not 0, as often as the byte before says, at most so. */\n"
        "struct tactable_layout {\n    uint32_t seed;\n    uint16_t length;\n    uint8_t length_each;\n"
        f"    uint8_t most;\n    uint8_t type;\n}};\n\n#define TACTABLE_LAYOUTS \\\n{rows}\n\n"
        "/* No body that a device sends is longer. */\n"
        f"#define TACTABLE_SENT_BODY_BOUND(number_of_actuators) \\\n    {_bound_text(sent)}\n\n"
        f"/* No body is longer. */\n#define TACTABLE_BODY_BOUND(number_of_actuators) \\\n    {_bound_text(layouts)}\n"
    )


def _bound_text(layouts: list[Layout]) -> str:
    by_actuator = [layout for layout in layouts if layout.most is None]
    fixed, each = max(layout.length(0) for layout in by_actuator), max(map(_each, by_actuator))
    bound, counted = f"{fixed}u + {each}u * (number_of_actuators)", max(layout.longest(0) for layout in layouts)
    return f"({bound} > {counted}u ? {bound} : {counted}u)"


def _message_text(layout: Layout) -> str:
    name, upper = _name(layout), layout.message.wire_name
    lines = [f"/* {layout.message.wire_name}, sent by {layout.message.sender}. {layout.message.purpose()}. */"]
    lines.append(f"#define TACTABLE_{upper}_TYPE {layout.message.type_byte:#04x}u")
    if layout.words:
        lines += ["", f"struct tactable_{name} {{", *_members(layout.words), "};"]
    if layout.repeated and _has_items(layout):
        lines += ["", f"struct {_item(layout)} {{", *_members(list(layout.repeated[1].words)), "};"]
    if layout.message.sender is not Sender.DEVICE:
        lines += _reader(layout) + _item_reader(layout)
    if layout.message.sender is not Sender.HOST:
        lines += _writer(layout) + _item_writer(layout)
    return "\n".join(lines) + "\n"


def _members(words: list[tuple[str, Word]]) -> list[str]:
    return [f"    {_c_type(word)}{name};{f' /* {word.unit} */' * bool(word.unit)}" for name, word in words]


def _reader(layout: Layout) -> list[str]:
    if not layout.words:
        return []
    name, offset = _name(layout), 2
    lines = ["", f"static inline bool tactable_read_{name}(const uint8_t *body, struct tactable_{name} *message)", "{"]
    for field, word in layout.words:
        lines.append(f"    message->{field} = {_get(word, f'body + {offset}')};")
        offset += _size(word)
    checks = [
        _is_known(f"message->{field}", kind)
        for (field, _), kind in zip(layout.words, layout.converters, strict=True)
        if isinstance(kind, type) and issubclass(kind, Enum)
    ]
    return [*lines, f"    return {' && '.join(checks) or 'true'};", "}"]


def _is_known(value: str, kind: type[Enum]) -> str:
    known = [int(member.value) for member in kind]
    if issubclass(kind, IntFlag):
        return f"({value} & ~{sum(known):#x}u) == 0"
    assert sorted(known) == list(range(len(known))), f"{kind.__name__} has a gap; the C reader checks a range"
    return f"{value} <= {max(known)}u"


def _item_reader(layout: Layout) -> list[str]:
    if not layout.repeated:
        return []
    item, offset = _item(layout), 0
    lines = [
        "",
        f"static inline struct {item} {item.replace('tactable_', 'tactable_read_')}(const uint8_t *body, size_t index)",
        "{",
        f"    const uint8_t *at = body + {layout.length(0)} + {_each(layout)} * index;",
        f"    struct {item} item;",
    ]
    for field, word in layout.repeated[1].words:
        lines.append(f"    item.{field} = {_get(word, f'at + {offset}')};")
        offset += _size(word)
    return [*lines, "    return item;", "}"]


def _writer(layout: Layout) -> list[str]:
    name = _name(layout)
    return [
        "",
        f"static inline uint8_t *tactable_write_{name}(uint8_t *at, uint8_t sequence, "
        f"const struct tactable_{name} *message)",
        "{",
        f"    at = put_u8(at, TACTABLE_{layout.message.wire_name}_TYPE);",
        "    at = put_u8(at, sequence);",
        *(f"    at = put_{word.kind}(at, message->{field});" for field, word in layout.words),
        "    return at;",
        "}",
    ]


def _item_writer(layout: Layout) -> list[str]:
    if not layout.repeated or not _has_items(layout):
        return []
    item = _item(layout)
    return [
        "",
        f"static inline uint8_t *{item.replace('tactable_', 'tactable_write_')}("
        f"uint8_t *at, const struct {item} *item)",
        "{",
        *(f"    at = put_{word.kind}(at, item->{field});" for field, word in layout.repeated[1].words),
        "    return at;",
        "}",
    ]


def _has_items(layout: Layout) -> bool:
    """Whether the firmware handles items one by one; the values of a stream it writes as they are."""
    return layout.most is None or layout.message.sender is not Sender.DEVICE


def _item(layout: Layout) -> str:
    """The structure of what a message repeats."""
    return f"tactable_{_name(layout)}_{'channel' if layout.most is None else 'item'}"


def _name(layout: Layout) -> str:
    return layout.message.wire_name.lower()


def _each(layout: Layout) -> int:
    return layout.length(1) - layout.length(0)


def _c_type(word: Word) -> str:
    if word.block_size is not None:
        return "const uint8_t *"
    return f"{'int' if word.kind[0] == 'i' else 'uint'}{word.kind[1:]}_t "


def _get(word: Word, at: str) -> str:
    if word.block_size is not None:
        return at
    read = f"get_u{word.kind[1:]}({at})"
    return read if word.kind[0] == "u" else f"({_c_type(word).strip()}){read}"


def _size(word: Word) -> int:
    return word.block_size or int(word.kind[1:]) // 8


if __name__ == "__main__":
    HEADER.write_text(build_header(), encoding="ascii")
