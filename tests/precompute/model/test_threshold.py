"""Laws of the detection threshold: the published points, straight lines in dB over log frequency between and beyond."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from precompute.model.threshold import detection_threshold
from tests.precompute.devices import unhurried
from tests.precompute.entries.dense_state import THRESHOLD_DB, threshold


def level_db(*frequency_hz: float) -> list[float]:
    decibels: list[float] = (20 * np.log10(detection_threshold(np.array(frequency_hz)) / 1e-6)).tolist()
    return decibels


def test_the_published_points_are_met() -> None:
    assert level_db(*THRESHOLD_DB) == pytest.approx(list(THRESHOLD_DB.values()))


@unhurried
@given(st.floats(40, 300))
def test_between_them_it_is_what_numpy_interpolates(frequency_hz: float) -> None:
    assert detection_threshold(np.array([frequency_hz]))[0] == pytest.approx(threshold(frequency_hz))


@unhurried
@given(st.floats(0.05, 1.0))
def test_beyond_them_the_end_lines_go_on(octaves: float) -> None:
    first, second = level_db(40 / 2**octaves, 40.0)
    assert (first - second) / octaves == pytest.approx((113.0 - 110.6) / np.log2(60 / 40))
    last, beyond = level_db(300.0, 300 * 2**octaves)
    assert (beyond - last) / octaves == pytest.approx((105.5 - 102.3) / np.log2(300 / 250))


def test_skin_is_most_sensitive_about_250_hz() -> None:
    frequency_hz = np.linspace(40, 400, 721)
    assert 230 <= frequency_hz[detection_threshold(frequency_hz).argmin()] <= 260
