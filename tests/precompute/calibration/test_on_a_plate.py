"""What a calibration of a plate must show: values found again within their intervals, and a misread place named."""

from dataclasses import replace

import numpy as np
import pytest

from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.calibrate import calibrate
from precompute.calibration.fitted import calibrated_device
from precompute.calibration.measuring_plan import Accuracy, plan_after
from precompute.calibration.modal_fit import calibrate_modes
from precompute.measurements.measured_modes import parse_modes
from precompute.measurements.model import Flaws
from precompute.measurements.parameters import with_changes
from precompute.measurements.types import Kind
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.predict.at_positions import SAMPLES, compute_powers, sample_bars
from tests.precompute.devices import shipped, tablet
from tests.precompute.measured import NAN, read_bar
from tests.precompute.sampled import sample_cases

TRUTH = {"plate.youngs_modulus": 73.1e9, "actuator.stiffness": 18.2e3, "actuator.full_scale": 3.7e-6}
TRUTH |= {"plate.mass_damping": 2.0, "plate.stiffness_damping": 6e-5}
DRIVES_HZ = [[hz if i == j else NAN for j in range(3)] for hz in (66.0, 114.0, 162.0, 210.0, 281.0) for i in range(3)]


@pytest.mark.long
def test_values_are_found_within_their_intervals_and_the_device_file_says_them() -> None:
    device = shipped("reference-p")
    read = read_bar(device, TRUTH, [[*d, NAN] for d in DRIVES_HZ], Flaws(noise=0.02), points=8, kind=Kind.RESPONSE)
    found = calibrate(device, read, [*TRUTH, "plate.poissons_ratio"], starts=1)
    truth = {**TRUTH, "plate.poissons_ratio": 0.23}
    off = [2 * abs(e.value - truth[e.parameter.name]) / (e.high - e.low) for e in found.estimates]
    assert sum(each < 1 for each in off) >= len(off) - 1 and max(off) < 1.5, off
    assert all(each.high / each.low < 1.3 for each in found.estimates)
    new = calibrated_device(found)
    assert new.surface.poissons_ratio == pytest.approx(found.device.surface.poissons_ratio, rel=1e-9)  # type: ignore[union-attr]
    assert new.uncertainty is not None and new.uncertainty.fitted[-1].name == "plate.poissons_ratio"
    drive, cases = (np.full(4, 150.0), np.array([1.0, 0.5j, 0.0, 0.0])), sample_cases(new, (0, 4))
    powers = np.array([compute_powers(plate, cases, *drive)[0] for plate in sample_bars(new, SAMPLES)[0]])
    assert powers.shape == (SAMPLES, 2) and (powers.std(axis=0) > 0).all()
    step = plan_after(found, Accuracy(), 1).summary()["readings"][0]
    assert len(step["position_m"]) == 2 and max(step["shrinks"].values()) > 0


def test_modes_of_a_plate_give_its_modulus_and_a_spring() -> None:
    plate, truth = tablet(), {"plate.youngs_modulus": 72e9, "actuator[1].stiffness": 20e3}
    pole = compute_modal_model(compute_basis(assemble(with_changes(plate, truth)))).pole
    lowest = sorted(pole[(pole.imag > 0) & (abs(pole) < 2 * np.pi * 400)].tolist(), key=abs)
    rows = [f"{abs(p) / (2 * np.pi):.8f},{-100 * p.real / abs(p):.8f}\n" for p in lowest]
    modes = parse_modes("frequency (Hz),damping ratio (%)\n" + "".join(rows), plate, 0.0, "modes.csv")
    found = calibrate_modes(plate, modes, list(truth), starts=1)
    assert [each.value for each in found.estimates] == pytest.approx(list(truth.values()), rel=1e-4)


@pytest.mark.long
def test_a_misread_place_of_an_actuator_is_named_with_the_point() -> None:
    plate = tablet()
    moved = replace(plate.actuators[1], position_m=0.264 + 0.035j)
    true = replace(plate, actuators=(plate.actuators[0], moved, plate.actuators[2]))
    read = read_bar(true, {}, DRIVES_HZ[::4], Flaws(noise=0.01), points=4, kind=Kind.RESPONSE)
    names = ["plate.youngs_modulus", "actuator.full_scale"]
    report = adequacy_report(plate, calibrate(plate, read, names, starts=1), {})
    assert report["remedy"]["name"] == "actuator[2].position"
    assert report["remedy"]["length_m"] == pytest.approx([0.264, 0.035], abs=2e-4)
    assert "Measure actuator[2].position again: with 264 x 35 mm in the device file" in report["doubt"]
