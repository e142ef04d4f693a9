"""Reads one table of a TOML file key by key; wrong, missing and unknown keys are refused by name."""

import codecs
import difflib
import errno
import os
import re
import reprlib
import stat
import tomllib
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from base.points import point_words
from engine.device.quantity import QuantityError, read_quantity

HIGHEST_LEVEL_DB = 80.0  # 1.5 g is 33 to 41 dB (docs/theory.md); 80 dB is a hundred times that, beyond any bar
MOST_BYTES = 16 << 20  # greatest size of a text file: a hundred times the largest manifest that is known
MOST_DOTS = 100
"""Most dots of a line beside those of its numbers. Readers of TOML take the square of the parts of a dotted key, once
more for each key of its table: 31 kB took 3.6 s. tomlkit refuses keys of more than 100 parts."""
_DECIMAL = re.compile(r"[0-9]\.[0-9]")
_HUGE = re.compile(r"0[xob][0-9A-Fa-f_]{100}")
"""An integer that TOML does not have to hold, and that Python reads and then refuses to write in an error."""
_MISSPELT = 0.8  # similarity of a misspelt key to the right one; different keys are less alike
_Word = TypeVar("_Word", bound=str)


class TomlTable:
    """A table that is being read: each key is taken once, then `refuse_rest` refuses those that were not taken.

    Errors are of the class `family` and name file, key, value and what was expected.
    """

    family: ClassVar[type[ValueError]] = ValueError

    def __init__(self, source: str, path: str, table: object) -> None:
        self.source, self.path = source, path
        if not isinstance(table, dict):
            raise self.error("", table, f"expected a table [{path}]")
        self.left: dict[str, Any] = dict(table)
        self.known: list[str] = []

    @classmethod
    def parse(cls, text: str, source: str) -> Self:
        """The whole of a file; `source` names it in errors."""
        for number, line in enumerate(text.split("\n"), 1):
            if _DECIMAL.sub("", line).count(".") > MOST_DOTS or _HUGE.search(line):
                expected = f"expected at most {MOST_DOTS} dots in a line, and whole numbers of 64 bits"
                raise cls.family(f"{source}: line {number}: {reprlib.repr(line)}: {expected}")
        try:
            table = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # also numbers and nesting beyond what Python reads
            raise cls.family(f"{source}: not TOML: {error}") from error
        return cls(source, "", table)

    def error(self, key: str, value: object, expected: str) -> ValueError:
        """Make the error for a value; the caller raises it."""
        where = ".".join(part for part in (self.path, key) if part)
        return self.family(f"{self.source}: {where}: {reprlib.repr(value)}: {expected}")

    def has(self, key: str) -> bool:
        """Whether the table has an optional key."""
        if key not in self.known:
            self.known.append(key)
        return key in self.left

    def take_value(self, key: str, default: Any = None) -> Any:
        """The plain TOML value; without a default the key is required."""
        if self.has(key):
            return self.left.pop(key)
        if default is None:
            for near in difflib.get_close_matches(key, self.left, 1, _MISSPELT):
                raise self.error(near, self.left[near], f"unknown key; did you mean {key!r}?")
            raise self.family(f"{self.source}: {f'[{self.path}] ' if self.path else ''}has no key {key!r}")
        return default

    def tables(self, key: str) -> list[Self]:
        """One or more [[key]] tables."""
        tables = self.take_value(key)
        if not isinstance(tables, list) or not tables:
            raise self.error(key, tables, f"expected one or more [[{key}]] tables")
        return [type(self)(self.source, f"{key}[{i}]", table) for i, table in enumerate(tables, 1)]

    def quantity(
        self, key: str, unit: str, *, least: float = 0.0, exclusive: bool = False, default: str | None = None
    ) -> float:
        """A number with a unit, converted to `unit`."""
        return self.checked(key, self.take_value(key, default), unit, least=least, exclusive=exclusive)

    def checked(self, key: str, text: object, unit: str, *, least: float = 0.0, exclusive: bool = False) -> float:
        """As `quantity`, for a value that the caller has taken from the file."""
        try:
            value = read_quantity(text, unit)
        except QuantityError as error:
            raise self.family(f"{self.source}: {self.path + '.' if self.path else ''}{key}: {error}") from None
        if value < least or (exclusive and value == least):
            raise self.error(
                key, text, f"expected {'more than' if exclusive else 'at least'} {least:g} {unit}".rstrip()
            )
        return value

    def position(self, key: str, length_m: float, *, least: float = 0.0, default: str | None = None) -> float:
        """A position on the bar: a length from its start, or a percentage of its length."""
        return self.checked_position(key, self.take_value(key, default), length_m, least=least)

    def checked_position(
        self, key: str, text: object, length_m: float, *, least: float = 0.0, kind: str = "bar"
    ) -> float:
        """As `position`, for a value that the caller has taken from the file."""
        if isinstance(text, str) and text.rstrip().endswith("%"):
            value = self.checked(key, text, "", least=least) * length_m
        else:
            value = self.checked(key, text, "m", least=least)
        if value > length_m * (1 + 1e-12):
            raise self.error(key, text, f"is off the {kind}, which is {1e3 * length_m:g} mm long")
        return min(value, length_m)

    def point(self, key: str, corner_m: complex) -> complex:
        """A point of the surface that reaches from 0 to `corner_m`: on a plate a list of two positions."""
        return self.checked_point(key, self.take_value(key), corner_m)

    def checked_point(self, key: str, value: object, corner_m: complex) -> complex:
        """As `point`, for a value that the caller has taken from the file; a text such as "35 x 60 mm" does, too."""
        if not isinstance(corner_m, complex):
            return self.checked_position(key, value, corner_m)
        parts = point_words(value) if isinstance(value, str) else value
        if not isinstance(parts, list) or len(parts) != 2:
            raise self.error(key, value, "expected a point such as ['35 mm', '60 mm'], along and across the plate")
        along, across = parts
        x_m = self.checked_position(key, along, corner_m.real, kind="plate")
        return complex(x_m, self.checked_position(key, across, corner_m.imag, kind="plate"))

    def level_db(self, key: str, text: object) -> float:
        """A sensation level that was taken, such as "20 dB": dB above the detection threshold."""
        match = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?) ?dB", text) if isinstance(text, str) else None
        if match is None or float(match[1]) > HIGHEST_LEVEL_DB:
            raise self.error(key, text, f"expected 0 to {HIGHEST_LEVEL_DB:g} dB above threshold, such as '20 dB'")
        return float(match[1])

    def integer(self, key: str, least: int, greatest: int, default: int | None = None) -> int:
        """A whole number from `least` to `greatest`."""
        value = self.take_value(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= greatest:
            raise self.error(key, value, f"expected a whole number from {least} to {greatest}")
        return value

    def word(self, key: str, options: tuple[_Word, ...], default: _Word | None = None) -> _Word:
        """One of the options."""
        value = self.take_value(key, default)
        if value not in options:
            raise self.error(key, value, f"expected one of {', '.join(options)}")
        return options[options.index(value)]

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.take_value(key, default)
        if not isinstance(value, bool):
            raise self.error(key, value, "expected true or false")
        return value

    def sentence(self, key: str) -> str:
        """Any text, "" by default."""
        value = self.take_value(key, "")
        if not isinstance(value, str):
            raise self.error(key, value, "expected text")
        return value

    def name(self, key: str, default: str | None = None) -> str:
        """A short name that is safe in lists and paths."""
        value = self.take_value(key, default)
        if not isinstance(value, str) or not re.fullmatch(r"[^\s,;/][^,;/\n]{0,63}", value) or not value.isprintable():
            raise self.error(key, value, "expected a short printable name without comma, semicolon or slash")
        return value

    def refuse_rest(self) -> None:
        """Refuse the keys that were not taken."""
        for key, value in self.left.items():
            near = difflib.get_close_matches(key, self.known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known keys are {', '.join(self.known)}"
            raise self.error(key, value, f"unknown key{hint}")


def read_text(path: Path, family: type[ValueError]) -> str:
    """Read the text of a plain file.

    Raises OSError if the file does not exist, and an error of the family if it is a pipe or a device, which may never
    end, if it is larger than MOST_BYTES, or if it is neither UTF-8 nor, by its first bytes, UTF-16.
    """
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        raise family(f"{path}: is not a plain file; write its content into one")
    if status.st_size > MOST_BYTES:
        raise family(f"{path}: has {status.st_size} bytes; expected at most {MOST_BYTES}: name another file")
    with path.open("rb") as file:
        is_utf_16 = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:  # editors and spreadsheets begin a file with a byte order mark
        return path.read_text(encoding="utf-16" if is_utf_16 else "utf-8-sig")
    except UnicodeError as error:
        raise family(f"{path}: not UTF-8 text: {error}; save it as UTF-8") from error
