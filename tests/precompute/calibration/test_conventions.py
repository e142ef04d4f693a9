"""Laws of readings of another convention: named, with what remains, and never where the readings are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Complex
from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.calibrate import calibrate
from precompute.calibration.conventions import implausible_changes
from precompute.measurements.model import Flaws
from precompute.measurements.parameters import default_names
from precompute.measurements.types import Kind, Measurements
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, TRUTH, read_bar
from tests.quick import first_quick

DEVICE = shipped("reference-a")
HZ = (66.0, 110, 170, 209, 284)


def responses(noise: float = 0.02) -> Measurements:
    """Each actuator alone at every frequency and four places, of a bar like reference-a."""
    drives_hz = [drive for hz in HZ for drive in ((hz, NAN), (NAN, hz))]
    return read_bar(DEVICE, TRUTH, drives_hz, Flaws(noise=noise), points=4, kind=Kind.RESPONSE)


def convention_of(read: Measurements) -> dict[str, object] | None:
    """What a calibration says of the convention of these readings."""
    found: dict[str, object] | None = adequacy_report(
        DEVICE, calibrate(DEVICE, read, default_names(DEVICE), starts=1), {}
    )["convention"]
    return found


@pytest.mark.parametrize(
    "case",
    first_quick(
        [
            (lambda a, jw: a.conj() * np.exp(-1e-3 * jw.conj()), ["exp(-j w t)", "1 ms too"]),
            (lambda a, _: -a, ["sensor", "wrong sign"]),
            (lambda a, _: a.conj(), ["exp(-j w t)", "imaginary"]),
            (lambda a, jw: 1e3 * a / jw, ["velocities", "j w", "divide them by 1000"]),
            (lambda a, jw: a / jw**2, ["displacements", "-w^2"]),
            (lambda a, _: a / 9.80665, ["declare g"]),
            (lambda a, jw: a * np.exp(-2e-4 * jw), ["0.2 ms too late"]),
            (lambda a, jw: a * np.exp(-12e-3 * jw), ["12 ms too late"]),
        ]
    ),
)
def test_a_convention_that_explains_the_readings_is_named_with_what_remains(
    case: tuple[Callable[[Complex, Complex], Complex], list[str]],
) -> None:
    (convention, named), read = case, responses(noise=0.0)
    jw = 2j * np.pi * np.nanmax(read.frequency_hz, axis=1)
    found = convention_of(replace(read, acceleration=convention(read.acceleration, jw)))
    assert found is not None and found["misfit"] == pytest.approx(0.005, rel=0.1)
    assert [each for each in named if each not in str(found["text"])] == []


@pytest.mark.parametrize("turned", first_quick([0, 1]))
def test_one_plug_that_is_turned_is_named(turned: int) -> None:
    read = responses()
    sign = np.where(read.amplitude[:, turned] != 0, -1.0, 1.0)
    found = convention_of(replace(read, acceleration=sign * read.acceleration))
    assert found is not None and f"plug of {DEVICE.actuators[turned].name}" in str(found["text"])


def test_right_readings_have_no_other_convention() -> None:
    assert convention_of(responses(0.035)) is None


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
        *((changed(FULL_SCALE, factor), True) for factor in (9.80665, 1 / 9.80665, 2.0, 0.5, 0.707, 1.414)),
        *((changed(FULL_SCALE, factor), False) for factor in (1.8, 1 / 1.8)),
        *((changed(MODULUS, factor), False) for factor in (2.9, 1 / 2.9)),
        *((changed(DAMPING, factor), factor > 10) for factor in (9.0, 11.0)),  # it was guessed
        (changed("actuator[1].clamp", 20.0, 1e-3), False),  # no data sheet has it
        (changed(DAMPING, 1.0, before=3.0) | {"before": 0.0}, False),  # 0 has no factor
        # The first calibration of a bar whose damping by mass was all but 0: 10 fitted, from 1 or from 5 on possible.
        *((changed(DAMPING, 1e6, 1e-5, known) | {"knee": 0.3}, known < 0.9) for known in (0.9, 0.5)),
    ],
)
def test_a_value_that_is_known_to_lie_far_from_the_one_before_is_doubted_by_name(
    parameter: dict[str, object], is_doubted: bool
) -> None:
    doubts = implausible_changes([parameter])
    assert [str(parameter["name"]) in doubt for doubt in doubts] == [True] * is_doubted


@pytest.mark.parametrize(
    ("factor", "remedy"),
    [(9.0, "declare m/s^2"), (0.1, "declare g"), (0.707, "by 1.414"), (2.0, "by 2"), (5.0, "units")],
)
def test_a_full_scale_that_is_wrong_by_a_usual_constant_names_it(factor: float, remedy: str) -> None:
    assert remedy in implausible_changes([changed(FULL_SCALE, factor)])[0]
