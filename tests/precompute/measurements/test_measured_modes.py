"""Laws of files of modes: each form says the same modes; what is wrong is named with its place and the remedy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff

from precompute.measurements.measured_modes import parse_modes, read_modes
from precompute.measurements.types import MeasurementError
from tests.precompute.devices import shipped
from tests.precompute.measurements.test_uff import PLACE_M, nodes

DEVICE = shipped("reference-a")
HZ, DAMPING = np.array([95.0, 206.0]), np.array([0.0125, 0.004])


@pytest.mark.parametrize(
    "text",
    [
        "frequency (Hz),damping ratio (%)\n95,1.25\n206,0.4\n",
        "# from a program\nMode,Natural Frequency [kHz],Damping [1]\n1,0.095,0.0125\n2,0.206,0.004\n",
        "frequency (Hz),loss factor (%)\n95,2.5\n206,0.8\n",
        "frequency (Hz),Q\n95,40\n206,125\n",
    ],
)
def test_names_and_units_of_other_programs_say_the_same_modes(text: str) -> None:
    modes = parse_modes(text, DEVICE, 0.0, "m.csv")
    np.testing.assert_allclose(modes.frequency_hz, HZ)
    np.testing.assert_allclose(modes.damping_ratio, DAMPING)


def test_errors_shapes_and_the_sensor_are_read_and_empty_cells_are_unknown() -> None:
    text = (
        "frequency (Hz),damping ratio (%),frequency error (Hz),shape at 20 mm,shape at 50 %,sensor mass (g),"
        "sensor position (mm)\n95,,0.95,1,-0.5,2,30\n206,0.4,,0.2,,2,30\n"
    )
    modes = parse_modes(text, DEVICE, 0.0, "m.csv")
    assert np.isnan(modes.damping_ratio).tolist() == [True, False]
    assert modes.frequency_error[0] == pytest.approx(0.01)
    np.testing.assert_allclose(modes.place_m, [0.02, DEVICE.bar.length_m / 2])
    np.testing.assert_array_equal(modes.shape, [[1, -0.5], [0.2, np.nan]])
    assert (modes.sensor_mass_kg, modes.sensor_m) == pytest.approx((2e-3, 0.03))


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("frequency (Hz)\n", ("natural frequency", "rows")),
        ("damping ratio (%)\n1\n", ("natural frequency", "frequency (Hz)")),
        ("frequency (Hz)\n206\n95\n", ("row 3", "frequency", "rising")),
        ("frequency (Hz)\ninf\n", ("row 2", "frequency", "finite")),
        ("frequency (Hz)\n0\n", ("row 2", "frequency", "more than 0")),
        ("frequency (Hz),damping ratio (1)\n95,1.25\n", ("row 2", "damping ratio", "125 %")),
        ("frequency (Hz),Q\n95,0\n", ("row 2", "damping ratio")),
        ("frequency (Hz),Q,loss factor (%)\n95,40,2.5\n", ("loss factor", "Q", "keep one")),
        ("frequency (Hz),zeal (%)\n95,1\n", ("column 2", "zeal", "known are")),
        ("frequency (Hz),shape at 9 m\n95,1\n", ("shape at", "9000 mm", "length")),
        ("frequency (Hz),sensor mass (g)\n95,2\n", ("sensor mass", "sensor position (mm)")),
        ("frequency (Hz),sensor mass (g)\n95,2\n206,3\n", ("sensor mass", "rows")),
    ],
)
def test_what_is_wrong_is_named_with_its_place_and_the_remedy(text: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(MeasurementError) as refused:
        parse_modes(text, DEVICE, 0.0, "m.csv")
    assert all(part in str(refused.value) for part in ("m.csv", *parts)), refused.value


def shape_set(number: int, **changes: Any) -> dict[str, Any]:
    """A dataset 55: a normal mode of a frequency and a damping ratio, or a complex one of an eigenvalue."""
    z = np.array([1.0, -0.5, 0.2, 0.1]) * number
    keys: dict[str, Any] = {
        "type": 55,
        "model_type": 1,
        "analysis_type": 2,
        "data_ch": 2,
        "spec_data_type": 8,
        "data_type": 2,
    }
    keys |= {"n_data_per_node": 3, "load_case": 1, "mode_n": number, "modal_m": 1.0, "modal_damp_his": 0.0}
    keys |= {"node_nums": np.array(list(PLACE_M)), "r1": 0 * z, "r2": 0 * z, "r3": z}
    return keys | {"freq": HZ[number - 1], "modal_damp_vis": DAMPING[number - 1]} | changes


def test_universal_files_give_normal_and_complex_modes_with_their_shapes(tmp_path: Path) -> None:
    pole = 2 * np.pi * HZ[1] * (-DAMPING[1] + 1j * np.sqrt(1 - DAMPING[1] ** 2))
    turning = {"analysis_type": 3, "data_type": 5, "eig": pole, "modal_a": 1 + 0j, "modal_b": 0j}
    turning |= {f"r{i}": shape_set(2)[f"r{i}"] + 0j for i in (1, 2, 3)}
    path = tmp_path / "m.uff"
    pyuff.UFF(str(path)).write_sets([nodes(), shape_set(2, **turning), shape_set(1, modal_damp_vis=0.0)])
    modes = read_modes(path, DEVICE)
    np.testing.assert_allclose(modes.frequency_hz, HZ, rtol=1e-4)
    np.testing.assert_allclose(modes.damping_ratio, [np.nan, DAMPING[1]], rtol=1e-2)
    np.testing.assert_allclose(modes.place_m, list(PLACE_M.values()), rtol=1e-5)
    np.testing.assert_allclose(modes.shape[1], [2, -1, 0.4, 0.2], rtol=1e-4)


def test_a_universal_file_without_modes_or_with_another_analysis_is_refused(tmp_path: Path) -> None:
    for sets, part in (
        ([nodes()], "dataset 55"),
        ([nodes(), shape_set(1, analysis_type=5, freq_step_n=1)], "analysis_type"),
    ):
        path = tmp_path / f"{part}.uff"
        pyuff.UFF(str(path)).write_sets(sets)
        with pytest.raises(MeasurementError, match=part):
            read_modes(path, DEVICE)
