"""Points of a surface as numbers: metres from the start of a bar, x + jy from the first corner of a plate.

One number is one point on either surface, so arrays of points have no axis of their own, a difference of points is a
way, and its magnitude a distance. A point of a bar is real; points of a plate are complex.
"""

import math
import re
from typing import Any

_BETWEEN = " x "
_WORDS = re.compile(r"(.+?)\s*[x×]\s*(.+)")  # noqa: RUF001  # as people type it, and as it is printed


def is_within(point: complex, corner_m: complex, beyond_m: float = 0.0) -> bool:
    """Whether a point lies on the surface that reaches from 0 to `corner_m`, or at most so far beside it."""
    return is_between(point, 0.0, corner_m, beyond_m)


def is_between(point: complex, start_m: complex, stop_m: complex, beyond_m: float = 0.0) -> bool:
    """Whether a point lies in the stretch or rectangle between two corners, or at most so far beside it."""
    if not start_m.real - beyond_m <= point.real <= stop_m.real + beyond_m:
        return False
    return start_m.imag - beyond_m <= point.imag <= stop_m.imag + beyond_m


def clip_points(points: Any, corner_m: complex) -> Any:
    """The nearest points on the surface that reaches from 0 to `corner_m`, of one point or an array of them."""
    import numpy as np  # it takes 0.1 s, which who lists devices does not wait for

    x = np.clip(np.real(points), 0.0, corner_m.real)
    return x + 1j * np.clip(np.imag(points), 0.0, corner_m.imag) if isinstance(corner_m, complex) else x


def clip_point(point: complex, corner_m: complex) -> complex:
    """The nearest point on that surface, without NumPy, whose clip of one number takes 4 us more."""
    x_m = min(max(point.real, 0.0), corner_m.real)
    return complex(x_m, min(max(point.imag, 0.0), corner_m.imag)) if isinstance(corner_m, complex) else x_m


def point_at(corner_m: complex, along: float, across: float) -> complex:
    """The point at these fractions of the sides of the surface from 0 to `corner_m`; a bar has none across."""
    return complex(along * corner_m.real, across * corner_m.imag) if isinstance(corner_m, complex) else along * corner_m


def order_of(point: complex) -> tuple[float, float]:
    """What points are sorted by: along the surface first, then across it."""
    return point.real, point.imag


def parts_of(point: complex) -> tuple[float, ...]:
    """X of a point of a bar, x and y of one of a plate."""
    return (point.real, point.imag) if isinstance(point, complex) else (point,)


def point_text(point: complex, digits: int = 6, form: str = "g") -> str:
    """A point as people write it: "35 mm" on a bar, "35 x 60 mm" on a plate; `form`: of its numbers, g or f."""
    return _BETWEEN.join(f"{1e3 * part:.{digits}{form}}" for part in parts_of(point)) + " mm"


def point_words(text: str) -> list[str]:
    """The two lengths of a text such as "35 x 60 mm" or "35 mm x 6 cm"; the text itself where it is one length."""
    match = _WORDS.fullmatch(text.strip())
    if match is None:
        return [text]
    along, across = match.groups()
    unit = across.lstrip("+-.0123456789eE ")
    return [along if along.endswith(tuple("%mnµμ")) else f"{along} {unit}", across]


def rows_of_squares(count: int, corner_m: complex) -> int:
    """In how many rows `count` equal parts of a plate that ends at `corner_m` are most nearly square."""
    over_square = corner_m.real / corner_m.imag / count  # times the square of the rows: length of a part by its width
    rows = [n for n in range(1, count + 1) if count % n == 0]
    return min(rows, key=lambda n: abs(math.log(over_square * n**2)))


def sides_of(point: complex) -> tuple[float, float]:
    """X and y for a fixed layout of two numbers, y NaN on a bar; `point_of` reads them."""
    return (point.real, point.imag) if isinstance(point, complex) else (point, math.nan)


def point_of(x_m: float, y_m: float) -> complex:
    """The point that `sides_of` wrote."""
    return x_m if math.isnan(y_m) else complex(x_m, y_m)


def json_of(point: complex) -> float | list[float]:
    """A point for JSON: a number on a bar, a list of two on a plate."""
    return [point.real, point.imag] if isinstance(point, complex) else point


def point_of_json(value: Any) -> complex:
    """The point that `json_of` wrote. Raises ValueError for anything else."""
    parts = value if isinstance(value, list) else [value]
    if not 1 <= len(parts) <= 2 or not all(type(part) in (int, float) and math.isfinite(part) for part in parts):
        raise ValueError(value)
    return complex(*parts) if isinstance(value, list) else float(value)
