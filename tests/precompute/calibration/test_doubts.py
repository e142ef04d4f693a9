"""The judge of a fit, from its report."""

import pytest

from precompute.calibration.adequacy import LARGEST_MISFIT, doubts_of

PARAMETER = {
    "name": "bar.youngs_modulus",
    "unit": "Pa",
    "before": 70e9,
    "value": 80e9,
    "interval": [79e9, 81e9],
    "bounds": [47e9, 105e9],
    "known": "known",
}
REPORT = {"median_misfit": 0.01, "parameters": [PARAMETER]}


def test_a_fit_is_judged_by_its_misfit_its_residuals_and_its_conventions() -> None:
    assert doubts_of(REPORT) == []
    (doubt,) = doubts_of(REPORT | {"median_misfit": 1.1 * LARGEST_MISFIT})
    assert "typical misfit" in doubt
    assert doubts_of(REPORT | {"adequacy": {"doubt": "not noise"}}) == ["not noise"]
    of_convention = {"adequacy": {"doubt": "upside down", "convention": {}, "remedy": None}, "median_misfit": 1.0}
    assert len(doubts_of(REPORT | of_convention)) == 2
    of_convention["adequacy"] = {"doubt": "upside down", "convention": {"text": "upside down"}}
    assert doubts_of(REPORT | of_convention) == ["upside down"]


@pytest.mark.parametrize(
    ("change", "is_doubted"),
    [
        ({"value": 105e9, "interval": [103e9, 105e9]}, True),
        ({"value": 47e9, "interval": [47e9, 48e9]}, True),
        ({"value": 104e9}, False),
        ({"name": "bar.mass_damping", "unit": "1/s", "before": 1.0, "value": 0.0, "bounds": [0.0, 100.0]}, None),
    ],
)
def test_a_value_at_an_end_of_its_bounds_is_doubted_by_name_and_a_damping_may_be_0(
    change: dict[str, object], *, is_doubted: bool | None
) -> None:
    at_end = [
        doubt for doubt in doubts_of(REPORT | {"parameters": [PARAMETER | change, PARAMETER]}) if "an end" in doubt
    ]
    assert [str((PARAMETER | change)["name"]) in doubt for doubt in at_end] == [True] * bool(is_doubted)
