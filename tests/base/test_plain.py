"""Laws of plain values."""

import json
import math
from dataclasses import dataclass
from enum import Enum, IntEnum
from pathlib import Path

import numpy as np
import pytest

from base.plain import to_plain


class Colour(Enum):
    RED = "red"


class Place(IntEnum):
    LEFT = 1


@dataclass(frozen=True)
class Inner:
    colour: Colour
    places: tuple[Place, ...]


@dataclass(frozen=True)
class Outer:
    inner: Inner
    nothing: Inner | None
    level_db: float
    curve: np.ndarray
    by_colour: dict[Colour, Path]
    names: frozenset[str]


def test_a_report_becomes_what_json_reads_back() -> None:
    report = Outer(
        inner=Inner(Colour.RED, (Place.LEFT,)),
        nothing=None,
        level_db=math.inf,
        curve=np.array([[1.0, math.nan], [2.5, 3.0]]),
        by_colour={Colour.RED: Path("a/b")},
        names=frozenset({"y", "x"}),
    )
    plain = to_plain(report)
    assert plain == {
        "inner": {"colour": "red", "places": [1]},
        "nothing": None,
        "level_db": None,
        "curve": [[1.0, None], [2.5, 3.0]],
        "by_colour": {"red": "a/b"},
        "names": ["x", "y"],
    }
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain


@pytest.mark.parametrize(
    ("value", "plain"),
    [(np.float64(0.5), 0.5), (np.int16(3), 3), (np.bool_(True), True), (-math.inf, None), ("text", "text"), ([], [])],
)
def test_numbers_of_arrays_are_numbers(value: object, plain: object) -> None:
    found = to_plain(value)
    assert found == plain
    assert type(found) is type(plain)


@pytest.mark.parametrize("value", [b"bytes", object(), Inner, np.array([b"bytes"])])
def test_what_json_cannot_say_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="no plain form"):
        to_plain(value)


def test_a_complex_number_is_its_two_parts() -> None:
    assert to_plain({"at": 1 + 2j, "all": np.array([3j])}) == {"at": [1.0, 2.0], "all": [[0.0, 3.0]]}
