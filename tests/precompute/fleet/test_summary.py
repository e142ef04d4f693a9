"""Laws of the summary: columns are what varies, and a unit stands out by the same whatever the others' worst does."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.device.values import Value, number_of
from precompute.fleet.summary import OUTLYING, summarise, summary_csv, summary_json
from precompute.fleet.units import Outcome, Unit
from precompute.fleet.verdict import FEWEST


def outcome(name: str, stiffness: float, contrast_db: float | None = 5.0) -> Outcome:
    values: dict[str, Value] = {"actuator[1].stiffness_n_per_m": stiffness, "bar.length_m": 0.2794, "name": "bar"}
    return Outcome(name, "key", 1.5, fingerprint="f", values=values, figures={"worst_contrast_db": contrast_db})


def fleet(count: int, seed: int = 0) -> list[Outcome]:
    normal = np.random.default_rng(seed).standard_normal(count)
    return [outcome(f"u{i}", 18900.0 + 100.0 * value) for i, value in enumerate(normal.tolist())]


def units_of(outcomes: list[Outcome], **values: str) -> list[Unit]:
    return [Unit(each.name, Path("bar.toml"), None, values) for each in outcomes]


def test_columns_are_the_numbers_that_vary() -> None:
    found = summarise(units_of(many := fleet(30)), many)
    assert [column.name for column in found.columns] == ["actuator[1].stiffness_n_per_m"]
    column = found.columns[0]
    assert column.median == pytest.approx(18900.0, abs=50.0)
    assert column.spread == pytest.approx(100.0, rel=0.35)
    numbers = {each.name: number_of(each.values[column.name]) or 0.0 for each in many}
    assert (column.least, column.greatest) == (min(numbers.values()), max(numbers.values()))
    assert numbers[column.least_unit] == column.least


@pytest.mark.parametrize("distance", [700.0, 7e6])
def test_a_unit_far_from_the_others_stands_out_however_far(distance: float) -> None:
    many = [*fleet(40), outcome("odd", 18900.0 + distance)]
    found = summarise(units_of(many), many)
    assert found.outliers[0].unit == "odd"
    assert found.outliers[0].deviation == pytest.approx(distance / 189, rel=0.1)  # 1 % of the median
    assert all(abs(outlier.deviation) > OUTLYING for outlier in found.outliers)


@pytest.mark.parametrize(
    ("others", "odd", "stand_out"),
    [
        ([18900.0] * 20, 19600.0, ["odd"]),
        ([18900.0] * 20, 19400.0, []),  # the spread is at least 1 %
        ([18900.0 + i for i in range(FEWEST - 2)], 1.0, []),
        ([18900.0 + i for i in range(FEWEST - 1)], 1.0, ["odd"]),
    ],
)
def test_one_that_differs_from_others_stands_out_if_they_are_enough(
    others: list[float], odd: float, stand_out: list[str]
) -> None:
    many = [*(outcome(f"u{i}", value) for i, value in enumerate(others)), outcome("odd", odd)]
    assert [outlier.unit for outlier in summarise(units_of(many), many).outliers] == stand_out


def test_a_drift_is_told_by_its_size_and_next_to_never_where_there_is_none() -> None:
    """40 units with a spread of 100 N/m, which gain 400 N/m in all or nothing."""

    def drift_of(gained: float, seed: int) -> float | None:
        values = 18900.0 + 100.0 * np.random.default_rng(seed).standard_normal(40) + np.linspace(0, gained, 40)
        many = [outcome(f"u{i}", value) for i, value in enumerate(values.tolist())]
        return summarise(units_of(many), many).columns[0].drift

    found = [drift or 0.0 for drift in (drift_of(400.0, seed) for seed in range(20))]
    assert min(found) > 200
    assert np.mean(found) == pytest.approx(400, rel=0.15)
    assert sum(drift_of(0.0, seed) is not None for seed in range(200)) <= 4  # 1 in the mean


def test_what_was_chosen_to_vary_does_not_stand_out() -> None:
    many = [*fleet(20), outcome("odd", 1.0, 90.0)]
    for key in ("actuator[1].stiffness", "actuator.stiffness"):
        assert [outlier.column for outlier in summarise(units_of(many, **{key: ""}), many).outliers] == [
            "worst_contrast_db"
        ]
    assert len(summarise(units_of(many, **{"actuator[2].stiffness": ""}), many).outliers) == 2


def test_failed_units_are_rows_but_no_numbers() -> None:
    many = [*fleet(5), Outcome("bad", "", error="bad/device.toml: no such file")]
    found = summarise(units_of(many), many)
    assert [each.name for each in found.failed] == ["bad"]
    rows = list(csv.DictReader(io.StringIO(summary_csv(found))))
    assert [row["status"] for row in rows] == ["built"] * 5 + ["failed"]
    assert rows[-1]["error"] == "bad/device.toml: no such file"
    assert rows[-1]["actuator[1].stiffness_n_per_m"] == ""
    assert float(rows[0]["actuator[1].stiffness_n_per_m"]) == many[0].values["actuator[1].stiffness_n_per_m"]


def test_json_holds_every_unit_and_what_stands_out() -> None:
    many = [*fleet(20), replace(outcome("odd", 1.0, None), is_kept=True)]
    values = json.loads(json.dumps(summary_json(summarise(units_of(many), many)), allow_nan=False))
    assert values["failed"] == 0
    odd = values["units"][-1]
    assert (odd["name"], odd["status"], odd["verdict"]) == ("odd", "kept", None)
    assert odd["figures"] == {"worst_contrast_db": None}
    assert values["outliers"][0]["unit"] == "odd"
    assert values["columns"][0]["least_unit"] == "odd"
