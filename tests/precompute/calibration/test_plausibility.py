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


@pytest.mark.parametrize("factor", [9.80665, 1 / 9.80665, 25.4, 2.0, 0.5])
def test_a_full_scale_in_another_unit_is_doubted(factor: float) -> None:
    (doubt,) = implausible_changes([changed("actuator[1].full_scale", factor)])
    assert "actuator[1].full_scale" in doubt
    assert "check the units" in doubt


@pytest.mark.parametrize(("name", "factor"), [("actuator[1].full_scale", 1.8), ("bar.youngs_modulus", 2.9)])
def test_an_ordinary_calibration_is_not_doubted(name: str, factor: float) -> None:
    assert implausible_changes([changed(name, factor), changed(name, 1 / factor)]) == []


def test_a_damping_may_be_far_off_since_it_was_guessed() -> None:
    assert implausible_changes([changed("bar.mass_damping", 9.0)]) == []
    assert implausible_changes([changed("bar.mass_damping", 11.0)]) != []


def test_a_value_that_was_zero_has_no_factor() -> None:
    assert implausible_changes([changed("bar.mass_damping", 1.0, before=3.0) | {"before": 0.0}]) == []


def test_a_value_that_the_measurements_hardly_tell_is_no_doubt() -> None:
    """The first calibration of a bar whose damping by mass was all but 0: 3.6 fitted, 0 to 11 possible."""
    assert implausible_changes([changed("bar.mass_damping", 3e5, before=1e-5, known=1.0)]) == []
    assert implausible_changes([changed("bar.mass_damping", 3e5, before=1e-5, known=0.9)]) != []
