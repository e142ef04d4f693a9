"""A study of one device to units: its values varied over a grid, or sampled evenly in a box."""

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from scipy.stats import qmc

from precompute.fleet.manifest import ManifestSection
from precompute.fleet.units import Unit

_MOST_UNITS = 100_000
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?) ?(\D.*)?")
_DIGITS = 8


def units_of_study(top: ManifestSection, folder: Path) -> Iterator[Unit]:
    """The table [study]: every combination of the listed values, or with a `count` a sample between two of each.

    With `judge`, the name of a table, its drives are judged on every variation, and no table is built.
    """
    part = ManifestSection(top.source, "study", top.take("study"))
    device = part.file("device", folder)
    judged = part.file("judge", folder) if "judge" in part.left else None
    is_sampled = "count" in part.left
    count = part.integer("count", 1, _MOST_UNITS, 1)
    seed = part.integer("seed", 0, 2**31 - 1, 0)
    listed = _listed(ManifestSection(part.source, "study.values", part.take("values")))
    part.known.append("judge")
    part.refuse_rest()
    rows = _sample(listed, count, seed, part) if is_sampled else _grid(listed, part)
    digits = len(str(len(rows) - 1))
    for i, row in enumerate(rows):
        yield Unit(f"{i:0{digits}d}", device, None, row, judged)


def _listed(part: ManifestSection) -> dict[str, list[str]]:
    found = {}
    for key, values in part.left.items():
        if not (isinstance(values, list) and values and all(isinstance(value, str) for value in values)):
            raise part.error(key, values, "expected a list of values with units, such as ['18 kN/m', '20 kN/m']")
        found[key] = values
    if not found:
        raise part.error("", {}, "expected at least one key of the device with its values")
    return found


def _grid(listed: Mapping[str, Sequence[str]], part: ManifestSection) -> list[dict[str, str]]:
    count = math.prod(map(len, listed.values()))
    if count > _MOST_UNITS:
        raise part.error("values", f"{count} combinations", f"expected at most {_MOST_UNITS}; or a count to sample")
    return [dict(zip(listed, row, strict=True)) for row in itertools.product(*listed.values())]


def _sample(listed: Mapping[str, Sequence[str]], count: int, seed: int, part: ManifestSection) -> list[dict[str, str]]:
    """A seeded Latin hypercube between the two values of each key."""
    ends = {key: _ends(key, values, part) for key, values in listed.items()}
    points = qmc.LatinHypercube(len(ends), seed=seed).random(count)
    return [
        {
            key: f"{low + at * (high - low):.{_DIGITS}g}{unit}"
            for (key, (low, high, unit)), at in zip(ends.items(), point, strict=True)
        }
        for point in points.tolist()
    ]


def _ends(key: str, values: Sequence[str], part: ManifestSection) -> tuple[float, float, str]:
    matches = [_QUANTITY.fullmatch(value.strip()) for value in values]
    if len(matches) != 2 or matches[0] is None or matches[1] is None or matches[0][2] != matches[1][2]:
        raise part.error(f"values.{key}", values, "expected the least and the greatest value, in the same unit")
    unit = matches[0][2]
    return float(matches[0][1]), float(matches[1][1]), f" {unit}" if unit else ""
