"""Journal of solved clicks beside a table that is being built, so that a killed build does not solve them again."""

import contextlib
import json
import zlib
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from base.files import unwritable
from engine.table import ClickEntry
from engine.table.click import ClickFinger, LevelSpread
from engine.touch import Placement
from engine.touch.places import Key, Places
from firmware_link.protocol.basis import Basis


class ClickStore:
    """An open journal with a line for each click of a basis; clicks of another device, code or options are dropped."""

    def __init__(self, table: Path, belongs_to: str, basis: Basis, places: Places) -> None:
        self.path = table.with_name(f".{table.name}.clicks")
        self._basis, self._places = basis, places
        self.clicks: dict[Key, ClickEntry] = {}
        """Clicks by the key of their placement."""
        lines = list(_sound_lines(self.path))
        head = {"belongs_to": belongs_to}
        if lines and lines[0] == head:
            self.clicks = {places.key(click.placement): click for click in (_decode(line, basis) for line in lines[1:])}
        try:
            self._file = self.path.open("w", encoding="utf-8")
        except OSError as error:
            raise unwritable(self.path, error) from error
        self._write(head)
        for click in self.clicks.values():
            self._write(_encode(click))

    def __enter__(self) -> "ClickStore":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):  # what the disk did not take was refused when it was written
            self._file.close()
        if not self.clicks:
            self.path.unlink()

    def add(self, click: ClickEntry) -> None:
        """Add a click, which may hold another copy of the basis, and flush it."""
        self.clicks[self._places.key(click.placement)] = replace(click, basis=self._basis)
        self._write(_encode(click))

    def _write(self, value: Any) -> None:
        text = json.dumps(value, default=asdict)
        try:
            self._file.write(f"{zlib.crc32(text.encode()):08x} {text}\n")
            self._file.flush()
        except OSError as error:
            raise unwritable(self.path, error) from error


def _sound_lines(path: Path) -> Iterator[Any]:
    """The lines up to the first that is damaged or incomplete."""
    if not path.exists():
        return
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        checksum, _, text = line.partition(" ")
        if checksum != f"{zlib.crc32(text.encode()):08x}":
            return
        yield json.loads(text)


def _encode(click: ClickEntry) -> dict[str, Any]:
    values = {field.name: getattr(click, field.name) for field in fields(click) if field.name != "basis"}
    return values | {"weights": click.weights.tolist(), "exceeds_s": list(click.exceeds_s.items())}


def _decode(values: dict[str, Any], basis: Basis) -> ClickEntry:
    made = {
        "basis": basis,
        "placement": Placement(**{key: tuple(each) for key, each in values["placement"].items()}),
        "weights": np.array(values["weights"], dtype=np.int16),
        "felt": LevelSpread(**values["felt"]),
        "quiet": None if values["quiet"] is None else LevelSpread(**values["quiet"]),
        "fingers": tuple(ClickFinger(**finger) for finger in values["fingers"]),
        "exceeds_s": dict(values["exceeds_s"]),
    }
    return ClickEntry(**values | made)
