"""Laws of values in other forms: plain ones for JSON, points as numbers, and text that commands no terminal."""

import json
import math
from dataclasses import dataclass
from enum import Enum, IntEnum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from base.plain import to_plain
from base.points import clip_point, clip_points, is_within
from base.printable import printable


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


parts_m = st.floats(-1.0, 1.0)


@given(parts_m, parts_m, st.floats(0.01, 0.5), st.floats(0.01, 0.5))
def test_a_clipped_point_is_the_nearest_on_the_surface(x_m: float, y_m: float, length_m: float, width_m: float) -> None:
    for point, corner_m in ((x_m, length_m), (complex(x_m, y_m), complex(length_m, width_m))):
        clipped = clip_point(point, corner_m)
        assert clipped == clip_points(point, corner_m)
        assert is_within(clipped, corner_m) and type(clipped) is type(point)


@pytest.mark.parametrize("code", ["\x1b", "\x07", "\r", "\x08", "\x00", "\x7f", "\x9b", "\u202e", "\u2066", "\udc80"])
def test_what_would_command_a_terminal_is_replaced(code: str) -> None:
    assert printable(f"a{code}b") == "a\N{REPLACEMENT CHARACTER}b"


@pytest.mark.parametrize("text", ["", "Bar 3, µm ± 4\tx\n", "指 ü\u00a0é\u202f10"])
def test_what_is_only_shown_stays(text: str) -> None:
    assert printable(text) == text
