"""Layout of a message: its class of annotated integers to bytes and back."""

import enum
import re
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple, get_args, get_type_hints

from firmware_link.protocol.link_errors import MessageError

_CODES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i16": "h"}
_BLOCK = re.compile(r"u8\[(\d+)\]")


class Sender(enum.StrEnum):
    """Sides that may send a message."""

    HOST = "host"
    DEVICE = "device"
    BOTH = "both"


class Word(NamedTuple):
    """One value on the wire: its kind, and the unit or scale that its name does not say.

    A kind is u8, u16, u32, u64 or i16, or u8[n]: exactly n bytes as they are.
    """

    kind: str
    unit: str = ""

    @property
    def block_size(self) -> int | None:
        """Bytes of a block; None for an integer."""
        block = _BLOCK.fullmatch(self.kind)
        return None if block is None else int(block[1])


class PerActuator(NamedTuple):
    """The last field of a message, repeated for each actuator: the named words of one actuator."""

    words: tuple[tuple[str, Word], ...]


class Counted(NamedTuple):
    """The last field of a message, repeated as often as the word before it says, at most `most` times."""

    words: tuple[tuple[str, Word], ...]
    most: int


@dataclass(frozen=True)
class Message:
    """A value that travels as one frame; its fields are annotated with `Word`, the last may be repeated.

    `PerActuator` and `Counted` mark a field that is repeated.

    The first line of a message's docstring is its purpose in PROTOCOL.md and in the C header.
    """

    wire_name: ClassVar[str]
    type_byte: ClassVar[int]
    sender: ClassVar[Sender]
    has_fixed_seed: ClassVar[bool]
    is_optional: ClassVar[bool]

    def __init_subclass__(
        cls,
        *,
        wire_name: str,
        type_byte: int,
        sender: Sender,
        has_fixed_seed: bool = False,
        is_optional: bool = False,
        **options: Any,
    ) -> None:
        super().__init_subclass__(**options)
        cls.wire_name, cls.type_byte, cls.sender = wire_name, type_byte, sender
        cls.has_fixed_seed, cls.is_optional = has_fixed_seed, is_optional

    @classmethod
    def purpose(cls) -> str:
        """Purpose of the message in a few words."""
        return (cls.__doc__ or "").partition("\n")[0].removesuffix(".")


class Layout:
    """Layout of the messages of one class in their bodies: `type u8, sequence u8, fields`, little-endian."""

    def __init__(self, message: type[Message]) -> None:
        hints = get_type_hints(message, include_extras=True)
        self.message = message
        self._type_byte = message.type_byte
        self.words: list[tuple[str, Word]] = []
        self.converters: list[Callable[[Any], Any]] = []
        self.repeated: tuple[str, PerActuator | Counted] | None = None
        self.repeated_is_raw = False
        for field in fields(message):
            kind, mark = get_args(hints[field.name])
            if isinstance(mark, PerActuator | Counted):
                self.repeated, self.repeated_is_raw = (field.name, mark), kind is bytes
            else:
                self.words.append((field.name, mark))
                self.converters.append(kind)
        self._fixed = struct.Struct("<BB" + _codes(self.words))
        self._values_of = _getter([name for name, _ in self.words])
        self._blocks = [(name, word) for name, word in self.words if word.block_size is not None]
        self._repeated_of = attrgetter(self.repeated[0]) if self.repeated else None
        self._repeated_codes = _codes(self.repeated[1].words) if self.repeated else ""
        self._repeated_size = struct.calcsize(f"<{self._repeated_codes}")
        name = f"{message.wire_name} {message.type_byte:#04x} {message.sender}"
        self.definition = f"{name}: {', '.join(self.field_texts())}"
        self.seed = 0 if message.has_fixed_seed else zlib.crc32(self.definition.encode("ascii"))

    @property
    def most(self) -> int | None:
        """How often a counted field is repeated at most; None where it is repeated for each actuator, or not at all."""
        mark = self.repeated[1] if self.repeated else None
        return mark.most if isinstance(mark, Counted) else None

    def length(self, repetitions: int) -> int:
        """Bytes of a body, type and sequence included, whose last field is repeated so often."""
        return self._fixed.size + self._repeated_size * repetitions

    def longest(self, number_of_actuators: int) -> int:
        """Bytes of the longest body for this number of actuators."""
        return self.length(number_of_actuators if self.most is None else self.most)

    def encode(self, message: Message, sequence: int) -> bytes:
        """Body of a message; raises MessageError for a value that does not fit its word."""
        try:
            for name, word in self._blocks:
                # `struct` would fill a short block up and cut a long one.
                if (size := len(getattr(message, name))) != word.block_size:
                    raise MessageError(f"{name} has {size} bytes; expected {word.block_size}")
            body = self._fixed.pack(self._type_byte, sequence, *self._values_of(message))
            return body if self._repeated_of is None else body + self._encode_repeated(self._repeated_of(message))
        except struct.error as error:
            raise MessageError(f"{message} with sequence {sequence} does not fit its words: {error}") from error

    def pack(self, sequence: int, *words: int) -> bytes:
        """The body up to what is repeated, of words that are known to fit: half the time of `encode`."""
        return self._fixed.pack(self._type_byte, sequence, *words)

    def decode(self, body: bytes) -> Message:
        """The message of a body of valid length; raises MessageError for a value that its meaning does not know."""
        _, _, *words = self._fixed.unpack_from(body)
        try:
            values: list[Any] = [convert(word) for convert, word in zip(self.converters, words, strict=True)]
        except ValueError as error:
            raise MessageError(f"{self.message.wire_name}: {error}") from error
        if self.repeated:
            values.append(self._decode_repeated(body[self._fixed.size :]))
        return self.message(*values)

    def field_texts(self) -> list[str]:
        """Every field as `name kind unit`, the repeated words in brackets, in wire order."""
        texts = [
            _word_text(name, word) + _members_text(kind)
            for (name, word), kind in zip(self.words, self.converters, strict=True)
        ]
        if self.repeated:
            texts.append(f"[{', '.join(_word_text(name, word) for name, word in self.repeated[1].words)}]")
        return texts

    def _encode_repeated(self, values: Any) -> bytes:
        if not self.repeated_is_raw:
            return struct.pack(f"<{len(values)}{self._repeated_codes}", *values)
        if len(values) % self._repeated_size:
            name = self.repeated[0] if self.repeated else ""
            raise MessageError(f"{name} has {len(values)} bytes; expected {self._repeated_size} an actuator")
        return bytes(values)

    def _decode_repeated(self, data: bytes) -> bytes | tuple[int, ...]:
        if self.repeated_is_raw:
            return data
        return struct.unpack(f"<{len(data) // self._repeated_size}{self._repeated_codes}", data)


def _codes(words: list[tuple[str, Word]] | tuple[tuple[str, Word], ...]) -> str:
    return "".join(_CODES.get(word.kind) or f"{word.block_size}s" for _, word in words)


def _getter(names: Sequence[str]) -> Callable[[Message], tuple[Any, ...]]:
    """All of a message's words in one call: a command is encoded between a touch and its answer."""
    if len(names) < 2:
        return lambda message: tuple(getattr(message, name) for name in names)
    return attrgetter(*names)


def _word_text(name: str, word: Word) -> str:
    return " ".join(part for part in (name, *word) if part)


def _members_text(kind: object) -> str:
    if not (isinstance(kind, type) and issubclass(kind, enum.Enum)):
        return ""
    return " {" + " ".join(f"{member.name}={member.value}" for member in kind) + "}"
