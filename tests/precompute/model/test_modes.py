"""Modes of a bar: those of the peaks of its responses."""

import numpy as np
import pytest

from precompute.model.assembly import assemble
from precompute.model.modal import Mode, compute_modes
from precompute.model.response import solve_response
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
POINTS_M = np.linspace(0.0, DEVICE.bar.length_m, 101)


def modes_of(up_to_hz: float) -> tuple[Mode, ...]:
    return compute_modes(DEVICE, POINTS_M, up_to_hz, ())


def test_frequency_and_damping_are_those_of_the_peak_of_the_response() -> None:
    """At f (1 +- zeta) the magnitude of a mode far from others is 1 / sqrt 2 of that at its peak."""
    mode = modes_of(1000.0)[0]  # 34 Hz; the next is at 122 Hz
    about_hz = mode.frequency_hz * (1 + mode.damping_ratio * np.array([-1.0, 0.0, 1.0]))
    low, peak, high = np.abs(solve_response(assemble(DEVICE), about_hz).displacement_m[:, 0, 0])
    assert [low / peak, high / peak] == pytest.approx([2**-0.5] * 2, rel=0.08)


def test_the_modes_rise_and_end_where_they_are_asked_to() -> None:
    found = [mode.frequency_hz for mode in modes_of(up_to_hz=300.0)]
    assert found == sorted(found) and found[-1] <= 300.0
    assert len(modes_of(up_to_hz=600.0)) > len(found)
