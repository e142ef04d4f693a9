"""Laws of adequacy: a fit that misses something is told from noise, with the parameter that mends it."""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from precompute.calibration.adequacy import adequacy_report, assess
from precompute.calibration.calibrate import Calibration, calibrate
from precompute.measurements.model import Flaws
from precompute.measurements.parameters import default_names, paper_names
from precompute.measurements.types import Kind
from tests.precompute.devices import shipped, with_actuators
from tests.precompute.measured import NAN, TRUTH, read_bar

pytestmark = pytest.mark.long

DEVICE = shipped("reference-a")
FLAWS = Flaws(noise=0.02, wrong=0.05)


def fitted(truth: dict[str, float], names: tuple[str, ...], flaws: Flaws = FLAWS) -> Calibration:
    return calibrate(DEVICE, read_bar(DEVICE, truth, flaws=flaws), names, starts=1)


def outside(calibration: Calibration, truth: dict[str, float]) -> list[str]:
    """Parameters whose printed interval excludes the truth."""
    return [
        e.parameter.name
        for e in calibration.estimates
        if not e.low <= truth.get(e.parameter.name, e.parameter.start) <= e.high
    ]


@pytest.mark.parametrize("share", [0.94, 1.06])
def test_the_first_fit_takes_a_wrong_modulus_in_and_its_intervals_hold_the_truth(share: float) -> None:
    truth = {**TRUTH, "bar.youngs_modulus": share * DEVICE.bar.youngs_modulus_pa}
    found = fitted(truth, default_names(DEVICE))
    own = {f"actuator[{number}].full_scale": TRUTH["actuator.full_scale"] for number in (1, 2)}
    assert outside(found, truth | own) == []
    assert assess(found).is_noise
    assert adequacy_report(DEVICE, found, {})["doubt"] == ""


@pytest.mark.parametrize("noise", [0.001, 0.02])
def test_a_channel_that_is_late_is_named_though_it_spoils_its_own_phases_alone(noise: float) -> None:
    """With little noise the typical misfit stays at the noise, and the late channel's readings are taken for wrong."""
    hz = np.arange(60.0, 301.0, 24.0)
    alone = [[each, NAN] for each in hz] + [[NAN, each] for each in hz]
    late = {"actuator[2].delay": 125e-6}
    read = read_bar(DEVICE, late, alone, Flaws(noise=noise), kind=Kind.RESPONSE, points=5)
    found = calibrate(DEVICE, read, default_names(DEVICE), starts=1)
    report = adequacy_report(DEVICE, found, {})
    assert report["remedy"]["name"] == "actuator[2].delay"
    assert "Try --also actuator[2].delay: the" in report["doubt"]
    assert report["doubt"].endswith("the greater misfits would fall") == (noise < 0.01)


def test_bolts_that_the_file_does_not_mention_are_named_with_the_width_that_they_clamp() -> None:
    bolted = with_actuators(DEVICE, clamp_m=0.02)
    found = calibrate(DEVICE, read_bar(bolted, {}, flaws=FLAWS), default_names(DEVICE), starts=1)
    report = adequacy_report(DEVICE, found, {})
    assert report["remedy"]["name"] == "actuator.clamp"
    assert report["remedy"]["length_m"] == pytest.approx(0.02, abs=1e-3)
    assert report["remedy"]["misfit"] < 0.1 * report["misfit"]


def test_residuals_without_memory_or_smaller_than_of_any_sensor_are_no_doubt() -> None:
    found, random = fitted(TRUTH, paper_names(DEVICE), Flaws()), np.random.default_rng(1)
    noise: list[Array] = list(random.normal(0, 0.02, (1000, len(found.log_residual))))
    doubted = sum(not assess(replace(found, log_residual=row)).is_noise for row in noise)
    assert doubted <= 15  # of 1000 at a probability of 0.005
    wavy = replace(found, log_residual=np.full(len(found.log_residual), 1e-3))
    assert assess(wavy).chance < 1e-6 and assess(wavy).is_noise
    assert not assess(replace(found, log_residual=20 * wavy.log_residual)).is_noise


def test_repeats_tell_a_misfit_that_changes_its_sign_from_place_to_place() -> None:
    """The measurements twice over: the second reading of a place differs by 0.2 %, the fit misses both by 2 %."""
    found = fitted(TRUTH, paper_names(DEVICE), Flaws())
    rows = np.tile(np.arange(len(found.measurements)), 2)
    twice = replace(
        found,
        measurements=found.measurements.part(rows),
        is_wrong=np.zeros(len(rows), bool),
        log_residual=np.zeros(len(rows)),
    )
    random = np.random.default_rng(2)
    misses, repeats = random.normal(0, 0.02, len(rows) // 2), random.normal(0, 0.002, len(rows))
    told = assess(replace(twice, log_residual=np.tile(misses, 2) + repeats))
    assert told.chance > 0.005 and told.repeat_chance is not None and told.repeat_chance < 1e-6
    assert told.repeat_noise == pytest.approx(0.002, rel=0.3)
    noise = assess(replace(twice, log_residual=random.normal(0, 0.02, len(rows))))
    assert noise.is_noise and noise.repeat_chance is not None
