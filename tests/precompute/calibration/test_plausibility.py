"""Laws of the doubt about values that lie far from those before."""

from __future__ import annotations

import pytest

from precompute.calibration.plausibility import implausible_changes


def changed(name: str, factor: float, before: float = 1e-6, known: float = 0.01) -> dict[str, object]:
    """A report's parameter whose value is known to that fraction."""
    value = before * factor
    return {
        "name": name,
        "unit": "m",
        "before": before,
        "value": value,
        "interval": [value * (1 - known), value * (1 + known)],
    }


FULL_SCALE, MODULUS, DAMPING = "actuator[1].full_scale", "bar.youngs_modulus", "bar.mass_damping"


@pytest.mark.parametrize(
    ("parameter", "is_doubted"),
    [
        *((changed(FULL_SCALE, factor), True) for factor in (9.80665, 1 / 9.80665, 2.0, 0.5)),
        *((changed(FULL_SCALE, factor), False) for factor in (1.8, 1 / 1.8)),
        *((changed(MODULUS, factor), False) for factor in (2.9, 1 / 2.9)),
        *((changed(DAMPING, factor), factor > 10) for factor in (9.0, 11.0)),  # it was guessed
        (changed(DAMPING, 1.0, before=3.0) | {"before": 0.0}, False),  # 0 has no factor
        # The first calibration of a bar whose damping by mass was all but 0: 3.6 fitted, 0 to 11 possible.
        *((changed(DAMPING, 3e5, before=1e-5, known=known), known < 1) for known in (1.0, 0.9)),
    ],
)
def test_a_value_that_is_known_to_lie_far_from_the_one_before_is_doubted_by_name(
    parameter: dict[str, object], is_doubted: bool
) -> None:
    doubts = implausible_changes([parameter])
    assert [str(parameter["name"]) in doubt and "check the units" in doubt for doubt in doubts] == [True] * is_doubted
