"""Figures of a bar without a table: dead zones, drives by zone, the untouched optimum; drawn is what is computed."""

import numpy as np
import pytest

from precompute.entries.untouched import BarDrive, find_untouched_optima
from precompute.model.assembly import assemble
from precompute.model.steady import compute_steady_state
from precompute.studies.reach import compute_reach
from tactable.figures.file import FigureError, Picture
from tactable.figures.reach import plot_reach
from tactable.figures.zones import plot_optimum, plot_zones
from tests.precompute.devices import shipped, with_actuators, with_bar

DEVICE = shipped("reference-a")


@pytest.fixture(scope="module")
def reach() -> Picture:
    return plot_reach(DEVICE)


def two_tones(left_hz: float, right_hz: float) -> BarDrive:
    return BarDrive("", np.array([left_hz, right_hz]), np.ones(2, dtype=np.complex128))


def test_the_data_of_the_dead_zones_are_the_reach_of_each_place(reach: Picture) -> None:
    place_m = np.asarray(reach.columns["position (m)"])
    touched = compute_reach(assemble(DEVICE), place_m[::20], DEVICE.finger)
    name = "each actuator at its best frequency, under a finger there (m/s^2)"
    assert np.asarray(reach.columns[name])[::20] == pytest.approx(touched.tones, rel=1e-9)
    level = reach.columns["greatest level under a finger there (dB above threshold oh-choi-2019)"]
    assert np.asarray(level)[::20] == pytest.approx(touched.level_db)
    assert reach.summary["under_a_finger"]["least_m_per_s2"] == min(reach.columns[name])


def test_the_papers_limit_and_the_levels_of_the_table_are_drawn(reach: Picture) -> None:
    above, below = reach.figure.axes
    assert "1.5 g, the published bar" in {line.get_label() for line in above.lines}
    assert {text.get_text() for text in below.texts} == {"entries at 10 dB", "entries at 20 dB", "entries at 30 dB"}


def test_the_data_by_zone_are_the_steady_state_of_each_drive() -> None:
    drives = [two_tones(60.0, 90.0), two_tones(150.0, 130.0)]
    columns = plot_zones(DEVICE, drives).columns
    for k, drive in enumerate(drives):
        state = compute_steady_state(assemble(DEVICE), drive.frequency_hz, drive.amplitude)
        rows = slice(5 * k, 5 * k + 5)
        assert list(columns["localized factor (1)"][rows]) == pytest.approx(state.share.tolist())
        assert list(columns["peak acceleration (m/s^2)"][rows]) == pytest.approx(state.peak.tolist())
    assert sum(columns["localized factor (1)"]) == pytest.approx(2.0), "zones cover the bar"


def test_the_papers_figure_3_is_matched_as_roughly_as_physics_says() -> None:
    undamped = with_bar(DEVICE, mass_damping_per_s=0.0, stiffness_damping_s=0.0)
    demo = with_actuators(undamped, stiffness_n_per_m=20e3, damping_n_s_per_m=0.0265, full_scale_m=0.42e-6)
    (drive,) = plot_zones(demo, [two_tones(60.0, 90.0)]).summary["drives"]
    factor = drive["by_zone"]
    assert factor["I"] == pytest.approx(factor["V"], abs=0.01) and min(factor, key=factor.__getitem__) == "III"


def test_the_curve_of_a_drive_peaks_where_its_zones_do() -> None:
    picture = plot_zones(DEVICE, [two_tones(150.0, 200.0)])
    curve = next(line for line in picture.figure.axes[0].lines if line.get_label() == "left 150 Hz; right 200 Hz")
    assert np.max(np.asarray(curve.get_ydata())) == pytest.approx(
        max(picture.columns["peak acceleration (m/s^2)"]), rel=1e-3
    )


def test_the_optimum_is_drawn_with_its_wanted_zones() -> None:
    picture = plot_optimum(DEVICE, ["I", "III", "V"])
    names = {text.get_text() for text in picture.figure.axes[1].texts}
    assert {"I, wanted", "II", "III, wanted", "IV", "V, wanted"} <= names
    for found, drive in zip(picture.summary["drives"], find_untouched_optima(assemble(DEVICE), [0, 2, 4]), strict=True):
        share = compute_steady_state(assemble(DEVICE), drive.frequency_hz, drive.amplitude).share
        assert found["localized_factor"] == pytest.approx(share[[0, 2, 4]].sum())
    assert picture.summary["drives"][1]["localized_factor"] > picture.summary["drives"][0]["localized_factor"] > 0.8626


def test_more_drives_than_lines_are_refused() -> None:
    with pytest.raises(FigureError, match="5 drives: expected one to 4"):
        plot_zones(DEVICE, [two_tones(60.0 + k, 90.0) for k in range(5)])


def test_every_axis_and_column_has_its_unit_and_estimates_are_named(reach: Picture) -> None:
    pictures = [reach, plot_zones(DEVICE, [two_tones(60.0, 90.0)]), plot_optimum(DEVICE, ["I"])]
    for picture in pictures:
        assert all(header.endswith(")") for header in picture.columns if header not in ("drive", "zone"))
        labels = [label for axes in picture.figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert len(labels) >= 3 and all(label.endswith(")") for label in labels)
        assert "ESTIMATES" in picture.figure.get_supxlabel()
        assert set(DEVICE.estimated_values) <= set(picture.summary["estimated"])
