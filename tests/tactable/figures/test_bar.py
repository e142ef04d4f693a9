"""Figures of a bar without a table: dead zones, drives by zone, the untouched optimum; drawn is what is computed."""

from pathlib import Path

import numpy as np
import pytest

from precompute.model.assembly import assemble
from precompute.model.steady import compute_steady_state
from precompute.predict.untouched import BarDrive, find_untouched_optima
from precompute.studies.reach_along import compute_reach
from tactable.figures.reach_picture import plot_reach
from tactable.figures.zones import plot_optimum, plot_zones
from tests.precompute.devices import shipped
from tests.tactable.figures.pictures import check_picture

DEVICE = shipped("reference-a")


def test_the_data_of_the_dead_zones_are_the_reach_of_each_place(tmp_path: Path) -> None:
    reach = plot_reach(DEVICE)
    check_picture(reach, DEVICE, (), tmp_path)
    place_m = np.asarray(reach.columns["position (m)"])
    touched = compute_reach(assemble(DEVICE), place_m[::20], DEVICE.finger)
    name = "each actuator at its best frequency, under a finger there (m/s^2)"
    assert np.asarray(reach.columns[name])[::20] == pytest.approx(touched.tones, rel=1e-9)
    level = reach.columns["greatest level under a finger there (dB above threshold oh-choi-2019)"]
    assert np.asarray(level)[::20] == pytest.approx(touched.level_db)
    assert reach.summary["under_a_finger"]["least_m_per_s2"] == min(reach.columns[name])


def test_the_data_by_zone_are_the_steady_state_of_each_drive(tmp_path: Path) -> None:
    drives = [BarDrive("", np.array(hz), np.ones(2, dtype=np.complex128)) for hz in ((60.0, 90.0), (150.0, 130.0))]
    picture = plot_zones(DEVICE, drives)
    check_picture(picture, DEVICE, ("drive", "zone"), tmp_path)
    columns = picture.columns
    for k, drive in enumerate(drives):
        state = compute_steady_state(assemble(DEVICE), drive.frequency_hz, drive.amplitude)
        rows = slice(5 * k, 5 * k + 5)
        assert list(columns["localized factor (1)"][rows]) == pytest.approx(state.share.tolist())
        assert list(columns["peak acceleration (m/s^2)"][rows]) == pytest.approx(state.peak.tolist())
    assert sum(columns["localized factor (1)"]) == pytest.approx(2.0), "zones cover the bar"


def test_the_optimum_is_drawn_with_its_wanted_zones(tmp_path: Path) -> None:
    picture = plot_optimum(DEVICE, ["I", "III", "V"])
    check_picture(picture, DEVICE, ("drive", "zone"), tmp_path)
    names = {text.get_text() for text in picture.figure.axes[1].texts}
    assert {"I, wanted", "II", "III, wanted", "IV", "V, wanted"} <= names
    for found, drive in zip(picture.summary["drives"], find_untouched_optima(assemble(DEVICE), [0, 2, 4]), strict=True):
        share = compute_steady_state(assemble(DEVICE), drive.frequency_hz, drive.amplitude).share
        assert found["localized_factor"] == pytest.approx(share[[0, 2, 4]].sum())
    assert picture.summary["drives"][1]["localized_factor"] > picture.summary["drives"][0]["localized_factor"] > 0.8626
