"""A figure with its data to files: the picture, and its columns as CSV."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from base.errors import TactableError
from base.files import replace_file, write_text

if TYPE_CHECKING:  # matplotlib takes half a second, which commands that draw nothing do not pay
    from matplotlib.figure import Figure

_METADATA: Mapping[str, Mapping[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Metadata by the ending of a picture, without a date, so that the same data make the same file."""
_DOTS_PER_INCH = 150  # 1350 dots for 9 inches: a screen's width, and good enough for paper


class FigureError(TactableError, ValueError):
    """A picture cannot be made as asked; the message names the option, its value and what would do."""


@dataclass(frozen=True)
class Picture:
    """A figure with its data: columns of one length by their header, which carries the unit.

    `summary` is for machines, `caption` one line for people. `texts` are files by name that go beside the picture.
    """

    figure: "Figure"
    columns: Mapping[str, Sequence[Any] | NDArray[Any]]
    summary: Mapping[str, Any]
    caption: str
    texts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Outputs:
    """Files of a picture and of its data; None: not written."""

    picture: Path | None
    data: Path | None

    @property
    def paths(self) -> list[Path]:
        """The files that are written."""
        return [path for path in (self.picture, self.data) if path is not None]


def outputs_of(paths: Sequence[Path]) -> Outputs:
    """Outputs by the endings of paths: a picture, its data (.csv), or one of each.

    Raises FigureError before work is done: for an ending that says no format, two of a kind, and a missing folder.
    """
    data = [path for path in paths if path.suffix.lower() == ".csv"]
    pictures = [path for path in paths if path not in data]
    for path in pictures:
        if path.suffix.lower() not in _METADATA:
            raise FigureError(f"{path}: a picture ends in {', '.join(_METADATA)}, its data in .csv; choose one of them")
    for path in paths:
        if not path.parent.is_dir():
            raise FigureError(f"{path.parent}: no such folder; create it or choose another output")
    for kind in (pictures, data):
        if len(kind) > 1:
            raise FigureError(f"{kind[0]} and {kind[1]}: one picture is made, and one file of data; give one of each")
    return Outputs(*(kind[0] if kind else None for kind in (pictures, data)))


def write_outputs(picture: "Picture", outputs: Outputs) -> None:
    """Write the picture, its data, or both."""
    if outputs.picture is not None:
        write_picture(picture, outputs.picture)
    if outputs.data is not None:
        write_columns(picture, outputs.data)


def write_picture(picture: Picture, path: Path) -> None:
    """Write the figure in the format that the ending says."""
    import matplotlib

    # 42: letters stay letters, as journals ask.
    with matplotlib.rc_context({"svg.hashsalt": "tactable", "pdf.fonttype": 42}), replace_file(path) as made:
        ending = path.suffix.lower()
        picture.figure.savefig(made, format=ending[1:], dpi=_DOTS_PER_INCH, metadata=dict(_METADATA[ending]))


def write_texts(picture: Picture, folder: Path) -> list[Path]:
    """Write the texts that go beside the picture; their paths."""
    paths = [folder / name for name in picture.texts]
    for path, text in zip(paths, picture.texts.values(), strict=True):
        write_text(path, text)
    return paths


def write_columns(picture: Picture, path: Path) -> None:
    """Write the data: a header, then a row for each place; what is absent is empty."""
    with replace_file(path) as made, made.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(picture.columns)
        rows.writerows([_cell(value) for value in row] for row in zip(*picture.columns.values(), strict=True))


def _cell(value: Any) -> Any:
    """Numbers with all their digits."""
    if value is None or isinstance(value, str | int):
        return value
    return "" if math.isnan(value) else repr(float(value))
