"""Laws of universal files: responses written with pyuff are read as rows; what is wrong is named by its dataset."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff

from precompute.measurements.types import Kind, MeasurementError
from precompute.measurements.uff import read_uff
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
HZ = np.array([0.0, 120.0, 150.0, 180.0])
PLACE_M = {1: 0.02, 2: 0.13, 8: DEVICE.actuators[0].position_m, 9: DEVICE.actuators[1].position_m}


def nodes() -> dict[str, Any]:
    numbers, zero = list(PLACE_M), [0] * len(PLACE_M)
    return dict(
        pyuff.prepare_15(
            node_nums=numbers,
            def_cs=zero,
            disp_cs=zero,
            color=zero,
            x=[PLACE_M[n] for n in numbers],
            y=[0.0] * len(numbers),
            z=[0.0] * len(numbers),
        )
    )


def response(place: int, actuator: int, **changes: Any) -> dict[str, Any]:
    value = np.array([0, 1 + 2j, 3 - 1j, -2 + 0.5j]) * place
    keys = {
        "binary": 0,
        "func_type": 4,
        "rsp_node": place,
        "rsp_dir": 3,
        "ref_node": actuator,
        "ref_dir": 3,
        "data": value,
        "x": HZ,
        "id1": "made by a test",
        "rsp_ent_name": "bar",
        "ref_ent_name": "bar",
        "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 0,
        "ordinate_axis_units_lab": "m/s2",
    }
    return dict(pyuff.prepare_58(**(keys | changes)))


def written(folder: Path, *sets: dict[str, Any]) -> Path:
    path = folder / "x.uff"
    pyuff.UFF(str(path)).write_sets(list(sets), "add")
    return path


def test_every_line_of_every_response_is_a_row_whatever_its_unit(tmp_path: Path) -> None:
    found = read_uff(
        written(tmp_path, nodes(), response(1, 8), response(2, 9, ordinate_axis_units_lab="g")), DEVICE, 2e-3
    )
    assert found.kind is Kind.RESPONSE
    assert found.position_m == pytest.approx([0.02] * 3 + [0.13] * 3)
    assert found.frequency_hz[:3, 0].tolist() == HZ[1:].tolist()
    assert np.isnan(found.frequency_hz[:3, 1]).all() and np.isnan(found.frequency_hz[3:, 0]).all()
    assert found.amplitude.tolist() == [[1, 0]] * 3 + [[0, 1]] * 3
    value = np.array([1 + 2j, 3 - 1j, -2 + 0.5j])
    assert found.acceleration == pytest.approx(np.append(value, 2 * 9.80665 * value), rel=1e-4)
    assert found.sensor_mass_kg.tolist() == [2e-3] * 6


FORCE: dict[str, Any] = {"orddenom_spec_data_type": 13}
OMEGA = 2 * np.pi * HZ[1:]


@pytest.mark.parametrize(
    ("changes", "factor"),
    [
        (FORCE, 1.0),
        (FORCE | {"orddenom_axis_units_lab": "kN"}, 1e-3),
        (FORCE | {"orddenom_axis_units_lab": "N", "ordinate_axis_units_lab": "g/N"}, 9.80665),
        ({"ordinate_axis_units_lab": "(m/s^2)/N", "ref_dir": -3}, -1.0),
        ({"orddenom_axis_units_lab": "lbf"}, 1 / 4.4482216),
        ({"ordinate_force_unit_exp": -1}, 1.0),
        (FORCE | {"ordinate_spec_data_type": 11, "ordinate_axis_units_lab": "mm/s"}, 1e-3j * OMEGA),
        (FORCE | {"ordinate_spec_data_type": 8, "ordinate_axis_units_lab": "µm/N"}, -1e-6 * OMEGA**2),
        ({"ordinate_spec_data_type": 0, "ordinate_axis_units_lab": "mm/N"}, -1e-3 * OMEGA**2),
    ],
)
@pytest.mark.parametrize("reference", [8, 2])
def test_responses_to_a_force_anywhere_are_accelerations_per_newton(
    reference: int, changes: dict[str, Any], factor: complex, tmp_path: Path
) -> None:
    found = read_uff(written(tmp_path, nodes(), response(1, reference, **changes)), DEVICE, 0.0)
    assert found.force_m == pytest.approx([PLACE_M[reference]] * 3, rel=1e-4)
    assert found.acceleration == pytest.approx(factor * np.array([1 + 2j, 3 - 1j, -2 + 0.5j]), rel=1e-4)


def units(code: int, per_metre: float) -> dict[str, Any]:
    """Dataset 164, whose factor leads from metres to the file's unit."""
    others = {"temp_mode": 1, "force": 1.0, "temp": 1.0, "temp_offset": 0.0}
    return dict(pyuff.prepare_164(units_code=code, units_description="user's", length=per_metre, **others))


@pytest.mark.parametrize(
    ("changes", "factor"),
    [
        ({}, 1.0),
        ({"ordinate_axis_units_lab": "g"}, 9.80665),
        ({"ordinate_axis_units_lab": "mm/s2"}, 1e-3),
        ({"rsp_dir": -3}, -1.0),
        ({"rsp_dir": -3, "ref_dir": -3}, 1.0),
        ({"rsp_dir": 0, "ref_dir": 0}, 1.0),  # nothing said
        ({"x": HZ / 1e3, "abscissa_axis_units_lab": "kHz"}, 1.0),
    ],
)
def test_what_a_dataset_declares_is_read(changes: dict[str, Any], factor: float, tmp_path: Path) -> None:
    found = read_uff(written(tmp_path, nodes(), response(1, 8, **changes)), DEVICE, 0.0)
    assert found.acceleration == pytest.approx(factor * np.array([1 + 2j, 3 - 1j, -2 + 0.5j]), rel=1e-4)
    assert found.frequency_hz[:, 0] == pytest.approx(HZ[1:])


@pytest.mark.parametrize(("code", "per_metre"), [(1, 1.0), (2, 3.28084), (5, 1e3), (9, 1.0), (9, 1e3)])
def test_places_and_unlabelled_accelerations_are_in_the_unit_of_the_file(
    code: int, per_metre: float, tmp_path: Path
) -> None:
    places = nodes()
    places["x"] = per_metre * np.asarray(places["x"])
    part = response(1, 8, ordinate_axis_units_lab="NONE")
    part["data"] = per_metre * part["data"]
    found = read_uff(written(tmp_path, units(code, per_metre), places, part), DEVICE, 0.0)
    assert found.position_m == pytest.approx([0.02] * 3, rel=1e-4)
    assert found.acceleration[0] == pytest.approx(1 + 2j, rel=1e-4)


def test_a_last_line_that_is_filled_up_is_no_value(tmp_path: Path) -> None:
    path = written(tmp_path, nodes(), response(1, 8, x=HZ[1:], data=np.array([1 + 2j, 3 - 1j, -2 + 0.5j])))
    lines = path.read_text(encoding="ascii").splitlines()
    lines.insert(len(lines) - 1, f"{0:13.5e}{0:20.11e}{0:20.11e}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    assert len(read_uff(path, DEVICE, 0.0)) == 3


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        ([nodes()], "has no dataset 58"),
        ([nodes(), response(1, 8, func_type=1)], "dataset 2 (58): func_type: 1: expected a frequency response, 4"),
        (
            [nodes(), response(1, 8, ordinate_spec_data_type=13)],
            "ordinate_spec_data_type: 13: expected an acceleration",
        ),
        ([nodes(), response(1, 8, ordinate_spec_data_type=8)], "'m/s2' is the unit of acceleration, and ordinate_spec"),
        ([nodes(), response(1, 8, ordinate_spec_data_type=0, ordinate_axis_units_lab="NONE")], "says no quantity"),
        ([nodes(), response(1, 8), response(2, 8, **FORCE)], "dataset 3 (58) is per newton, dataset 2 of full"),
        ([nodes(), response(1, 8, orddenom_axis_units_lab="V")], "orddenom_axis_units_lab: "),
        ([nodes(), response(1, 8, orddenom_spec_data_type=12)], "orddenom_spec_data_type: 12: the response is per acc"),
        ([nodes(), response(1, 8, abscissa_spec_data_type=17)], "abscissa_spec_data_type: 17: expected a frequency"),
        ([nodes(), response(5, 8)], "rsp_node: node 5 has no place"),
        ([nodes(), response(1, 2)], "ref_node: 130 mm: is where no actuator is; they are left 44.704 mm"),
        (
            [nodes(), response(1, 8, ordinate_axis_units_lab="N")],
            "ordinate_axis_units_lab: 'N' is no unit of a response",
        ),
        ([units(9, 0.0), nodes(), response(1, 8)], "dataset 164: factor of length 0"),
        ([nodes(), response(1, 8, orddenom_spec_data_type=8)], "orddenom_spec_data_type: 8: the response is per displ"),
        ([nodes(), response(1, 8, rsp_dir=1)], "dataset 2 (58): rsp_dir: 1: expected 3 or -3, across the surface"),
        ([nodes(), response(1, 8, ref_dir=-2)], "ref_dir: -2: expected 3 or -3"),
        ([nodes(), response(1, 8, data=np.ones(4), ord_data_type=4)], "ord_data_type: 4: a response is complex"),
        ([nodes(), response(1, 8, abscissa_axis_units_lab="rpm")], "abscissa_axis_units_lab: "),
        ([nodes(), response(1, 8, data=np.zeros(4, complex))], "dataset 2 (58) at 120 Hz: acceleration: 0 m/s^2"),
    ],
)
def test_what_is_wrong_is_named_by_its_dataset(sets: list[dict[str, Any]], message: str, tmp_path: Path) -> None:
    with pytest.raises(MeasurementError) as caught:
        read_uff(written(tmp_path, *sets), DEVICE, 0.0)
    assert message in str(caught.value)


def test_nodes_whose_places_are_cut_off_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, nodes(), response(1, 8))
    lines = path.read_text(encoding="ascii").splitlines(keepends=True)
    for cut in (lines[3][:20] + "\n", lines[3].replace(lines[3].split()[4], "nan".rjust(len(lines[3].split()[4])))):
        path.write_text("".join([*lines[:3], cut, *lines[4:]]), encoding="ascii")
        with pytest.raises(MeasurementError):
            read_uff(path, DEVICE, 0.0)
