"""The greatest localized factor of the untouched bar: no sampled drive has more. Which estimates matter."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from base.arrays import Complex
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.gram import compute_steady_state
from precompute.model.plant import Plant
from precompute.predict.estimates import weigh_estimates
from precompute.predict.untouched import BarDrive, find_untouched_optima
from tests.precompute.devices import every_device, shipped
from tests.small_device import small_text


@cache
def plant_of(device_name: str) -> Plant:
    return assemble(every_device()[device_name])


def factor(device_name: str, drive: BarDrive, zones: list[int]) -> float:
    return float(compute_steady_state(plant_of(device_name), drive.frequency_hz, drive.amplitude).share[zones].sum())


@pytest.mark.parametrize("name", every_device())
def test_no_sampled_drive_has_a_greater_factor(name: str) -> None:
    device = every_device()[name]
    plant, zones = assemble(device), [0, 2]
    different, one = find_untouched_optima(plant, zones)
    best, coherent = factor(name, different, zones), factor(name, one, zones)
    assert coherent >= best - 1e-9
    random = np.random.default_rng(11)
    count = len(device.actuators)
    for _ in range(30):
        hz, amplitude = random.uniform(60.0, 300.0, count), random.uniform(0.0, 1.0, count)
        phase: Complex = np.exp(2j * np.pi * random.random(count))
        assert factor(name, BarDrive("", hz, amplitude.astype(np.complex128)), zones) <= best + 2e-3
        assert factor(name, BarDrive("", np.full(count, hz[0]), amplitude * phase), zones) <= coherent + 2e-3


@pytest.mark.parametrize(
    ("zones", "single", "coherent"),
    [([0, 2, 4], 0.955, 0.966), ([1], 0.385, 0.431), ([1, 3], 0.634, 0.731), ([3], 0.275, 0.328)],
    ids=["I, III, V of the paper's figure 8", "II", "II, IV", "IV"],
)
def test_the_optima_of_reference_a_are_those_of_the_documents(zones: list[int], single: float, coherent: float) -> None:
    different, one = find_untouched_optima(assemble(shipped("reference-a")), zones)
    assert [np.count_nonzero(drive.amplitude) for drive in (different, one)] == [1, 2]
    assert abs(one.amplitude).max() == pytest.approx(1.0)
    assert factor("reference-a", different, zones) == pytest.approx(single, abs=0.002)
    assert factor("reference-a", one, zones) == pytest.approx(coherent, abs=0.002)


def test_an_actuator_out_of_its_band_is_not_driven() -> None:
    device = shipped("reference-a")
    left, right = device.actuators
    narrow = replace(device, actuators=(replace(left, band_hz=(60.0, 61.0)), replace(right, band_hz=(250.0, 300.0))))
    different, one = find_untouched_optima(assemble(narrow), [0])
    for drive in (different, one):
        assert np.count_nonzero(drive.amplitude) == 1
        low_hz, high_hz = narrow.actuators[int(abs(drive.amplitude).argmax())].band_hz
        assert low_hz <= drive.frequency_hz[0] <= high_hz


def test_a_full_scale_scales_its_actuator_alone_and_what_is_beside_the_model_weighs_nothing() -> None:
    text = small_text().replace('inferred = ["mass", "band"]', 'inferred = ["full_scale", "band"]')
    device = Device.parse(text, "bar")
    weighed = dict(weigh_estimates(device))
    shares = [weighed[f"actuator[{number}].full_scale"] for number in (1, 2)]
    # Together the actuators are the whole response, whose tenth is a tenth of its norm.
    assert sum(share**2 for share in shares) == pytest.approx(0.01, rel=1e-6)
    assert not {"actuator[1].band", "finger.spread", "spread.mass"} & weighed.keys()
    assert list(weighed.values()) == sorted(weighed.values(), reverse=True)
