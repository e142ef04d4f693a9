"""Laws of stages: what is too few is not told, what was not measured is passed over, the guilty layer is named."""

import re
from pathlib import Path

import numpy as np
import pytest

from tactable.bench.latency.stages import (
    STAGES,
    Point,
    Stamps,
    blame,
    durations_of,
    figures_of,
    last_measured,
    misses_of,
    stages_json,
    us,
)

MEASURED = (Point.SENT, Point.READ, Point.FRAME, Point.STATE, Point.COMMAND, Point.WRITTEN)
WAYS_NS = dict(zip(MEASURED, (20e3, 30e3, 4e3, 3e3, 1e3, 9e3), strict=True))


def stamps_of(count: int, **late_ns: float) -> Stamps:
    """Commands that each took WAYS_NS; the last twentieth is late in the points named."""
    ways = np.tile([0.0, *WAYS_NS.values()], (count, 1))
    for name, extra_ns in late_ns.items():
        ways[-(count // 20) :, Point[name]] += extra_ns
    stamps = np.full((count, len(Point)), np.nan)
    stamps[:, : Point.WRITTEN + 1] = ways.cumsum(axis=1)
    return stamps


def test_without_samples_there_are_no_figures_what_is_not_known_is_a_dash_and_what_was_never_written_a_miss() -> None:
    assert figures_of(np.array([np.nan])) is None
    assert blame(stamps_of(0)) is None
    assert [us(value) for value in (None, float("nan"), 3.14159, 12345.6)] == ["-", "-", "3.1", "12346"]
    assert misses_of(np.array([2e6, np.nan, 0.5e6, 60e6])) == {"1 ms": 3, "5 ms": 2, "10 ms": 2, "20 ms": 2, "50 ms": 2}


def test_stages_add_up_to_the_way_and_each_begins_with_the_last_point_that_was_measured() -> None:
    told = stages_json(stamps_of(50))["stages"]
    assert told["due to written"]["p50_us"] == pytest.approx(67.0)
    assert sum(told[STAGES[point].name]["p50_us"] for point in WAYS_NS) == pytest.approx(67.0)
    stamps = stamps_of(3)
    stamps[:, [Point.FRAME, Point.STATE, Point.COMMAND]] = np.nan
    assert durations_of(stamps, Point.WRITTEN).tolist() == [17e3] * 3
    assert last_measured(stamps) is Point.WRITTEN


@pytest.mark.parametrize(
    ("point", "layer"),
    [("SENT", "digitizer"), ("READ", "host"), ("FRAME", "engine"), ("STATE", "engine"), ("WRITTEN", "link")],
)
def test_the_layer_that_was_late_is_named(point: str, layer: str) -> None:
    found = blame(stamps_of(1000, **{point: 5e6}))
    assert found is not None
    assert (found["slowest"]["layer"], found["slowest"]["stage"]) == (layer, STAGES[Point[point]].name)
    assert found["slowest"]["share"] > 0.99
    assert found["typical"]["layer"] == "host"


def test_the_document_names_every_stage_with_its_layer() -> None:
    text = (Path(__file__).parents[4] / "docs" / "latency.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([a-z() -]+) \| .* \| (\w+)[^|]* \|$", text, re.MULTILINE))
    assert {stage.name: stage.layer for stage in STAGES.values()}.items() <= rows.items()
