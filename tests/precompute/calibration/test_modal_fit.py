"""A fit of modes alone finds what changed, with modes missing; what modes cannot tell is said."""

import numpy as np
import pytest

from engine.device import Device
from precompute.calibration.calibrate import Known
from precompute.calibration.measuring_plan import open_combinations
from precompute.calibration.modal_fit import ModesMisfit, calibrate_modes, modal_names, modal_report
from precompute.measurements.measured_modes import Modes, parse_modes
from precompute.measurements.parameters import find_parameters, with_changes
from precompute.measurements.types import MeasurementError
from precompute.model.modal import compute_modes
from tests.precompute.devices import shipped

DEVICE = shipped("reference-d")
TRUTH = {
    "actuator[1].stiffness": 21.3e3,
    "actuator[2].stiffness": 16.1e3,
    "actuator.damping": 0.06,
    "bar.stiffness_damping": 7e-5,
    "bar.youngs_modulus": 73e9,
}


def modes_of(device: Device, left_out: tuple[int, ...] = (), scale: float = 1.0, shaped: bool = False) -> Modes:
    """The modes of a device up to 2 kHz without some, the second frequency scaled; with shapes at 11 places."""
    header, place_m = ["frequency (Hz)", "damping ratio (%)"], np.arange(5, 225, 20) / 1e3
    header += [f"shape at {1e3 * x:g} mm" for x in place_m if shaped]
    lines = [",".join(header)]
    for i, mode in enumerate(compute_modes(device, place_m, 2000)):
        row = [mode.frequency_hz * (scale if i == 1 else 1), 100 * mode.damping_ratio, *mode.shape]
        lines += [] if i in left_out else [",".join(f"{value:.12g}" for value in row[: len(header)])]
    return parse_modes("\n".join(lines), DEVICE, 0.0, "m.csv")


def test_slopes_are_the_derivatives_with_a_sensor_on_the_bar() -> None:
    text = "frequency (Hz),damping ratio (%),sensor mass (g),sensor position (mm)\n95,1,2,30\n206,,2,30\n450,5,2,30"
    modes = parse_modes(text, DEVICE, 0.0, "m.csv")
    names = (*modal_names(DEVICE, modes), "bar.density", "actuator.mass", "sensor.mass")
    misfit = ModesMisfit(DEVICE, modes, find_parameters(DEVICE, names, {}, 2e-3))
    at = np.array([p.coordinate(p.start) for p in misfit.parameters])
    for i, column in enumerate(misfit.at(at).log_slope.T):
        step = 1e-4 * (np.arange(len(at)) == i)
        apart = misfit.at(at + step).log_residual - misfit.at(at - step).log_residual
        np.testing.assert_allclose(column, apart / 2e-4, rtol=1e-3, atol=2e-5)


def test_what_changed_is_found_though_a_mode_is_missing() -> None:
    found = calibrate_modes(DEVICE, modes_of(with_changes(DEVICE, TRUTH), (1,)), list(TRUTH), starts=2)
    assert found.number.tolist() == [1, 3, 4, 5, 6]
    for estimate in found.estimates:
        truth = TRUTH[estimate.parameter.name]
        assert estimate.value == pytest.approx(truth, rel=1e-3)
        assert estimate.low <= truth <= estimate.high
    assert modal_report(found)["adequacy"]["doubt"] == ""


def test_a_shape_pairs_where_the_frequency_would_not() -> None:
    """The fourth mode of a stiff bar has the frequency of the fifth of a soft one."""
    stiffer = with_changes(DEVICE, {"bar.youngs_modulus": 1.45 * DEVICE.bar.youngs_modulus_pa})
    alone = modes_of(stiffer, (0, 1, 2, 4, 5), shaped=True)
    parameters = find_parameters(DEVICE, ["bar.youngs_modulus"], {}, 0.0)
    at = np.array([np.log(0.6 * DEVICE.bar.youngs_modulus_pa)])
    assert ModesMisfit(DEVICE, alone, parameters).model_at(at)[1].tolist() == [3]


def test_what_modes_cannot_tell_is_said() -> None:
    modes = modes_of(DEVICE)
    with pytest.raises(MeasurementError, match=r"actuator\.full_scale: not identifiable"):
        calibrate_modes(DEVICE, modes, ["actuator.full_scale"], starts=1)
    many = "\n".join(str(hz) for hz in range(10, 5000, 10))
    with pytest.raises(MeasurementError, match="499 modes"):
        calibrate_modes(DEVICE, parse_modes(f"frequency (Hz)\n{many}", DEVICE, 0.0, "m.csv"), starts=1)
    scale = ["actuator.stiffness", "bar.youngs_modulus", "bar.density", "actuator.mass"]
    found = calibrate_modes(DEVICE, modes, scale, starts=1)
    (combination,) = open_combinations(found)
    assert combination.parts.keys() >= {"bar.youngs_modulus", "bar.density"}
    assert found.estimates[1].known is not Known.WELL
    assert "full_scale" in modal_report(found)["open"][-1]["text"]


def test_a_mode_that_is_not_the_bar_s_is_doubted_by_its_frequency() -> None:
    found = calibrate_modes(DEVICE, modes_of(DEVICE, scale=1.1), ["bar.youngs_modulus"], starts=1)
    doubt = modal_report(found)["adequacy"]["doubt"]
    assert f"{found.modes.frequency_hz[1]:.6g} Hz" in doubt and "check" in doubt
