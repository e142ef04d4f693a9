"""Delay and gain between channels: what their ratios at two tones say, and what a walk makes of loopbacks."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import with_changes
from precompute.measurements.types import Kind
from tactable.measure.channels import Channel, channels_of
from tactable.measure.walk import RawFolder, even_walk, measurements_of
from tests.engine.loop.rig import DEVICE
from tests.tactable.cli.in_process import run_here, summary_of
from tests.tactable.measure.test_walk import walked

WALK = even_walk(DEVICE, 2, [170.0, 209.0])
TONES_HZ = (84.0, 276.0)


@given(st.floats(0.2, 5.0), st.sampled_from((1.0, -1.0)), st.floats(-2.5e-3, 2.5e-3))
def test_two_tones_tell_gain_sign_and_delay(gain: float, sign: float, delay_s: float) -> None:
    true = Channel(sign * gain, delay_s)
    first, found = channels_of(TONES_HZ, [np.array([1.0, true.factor(hz)]) for hz in TONES_HZ])
    assert (first.gain, first.delay_s) == (1.0, 0.0)
    assert found.gain == pytest.approx(true.gain) and found.delay_s == pytest.approx(delay_s, abs=1e-9)


def test_a_channel_that_is_late_is_told_by_the_loopbacks_and_its_responses_are_those_of_the_command(
    tmp_path: Path,
) -> None:
    records = walked(tmp_path / "raw", WALK, "late=125us,drift=40")
    assert not records[1].channels  # once a walk
    assert records[0].channels[1].delay_s == pytest.approx(125e-6, abs=1e-6)
    assert records[0].channels[1].gain == pytest.approx(1.0, abs=1e-3)
    late = with_changes(DEVICE, {"actuator[2].delay": 125e-6})
    found = measurements_of(records, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    ratios = [
        found.acceleration / np.exp(MeasurementModel(device, found, ()).predict(np.zeros(0)).log_acceleration)
        for device in (late, DEVICE)
    ]
    right = found.amplitude[:, 1] != 0
    assert abs(np.degrees(np.angle(ratios[0]))).max() < 0.5
    turned = np.degrees(np.angle(ratios[1]))
    assert turned[right] == pytest.approx(-360 * 125e-6 * found.frequency_hz[right, 1], abs=0.5)
    kept = RawFolder(tmp_path / "raw", DEVICE, WALK, {"flaws": "late=125us,drift=40"})
    assert kept.read(WALK[0]) == records[0]


def test_loopbacks_that_are_equal_to_the_last_bit_tell_nothing(tmp_path: Path) -> None:
    records = walked(tmp_path / "raw", WALK[:1])
    assert records[0].channels == ()
    same = measurements_of(records, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    told = (replace(records[0], channels=(Channel(1.0, 0.0), Channel(1.02, 0.0))),)
    more = measurements_of(told, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    factor = np.where(same.amplitude[:, 1] != 0, 1.02, 1.0)
    np.testing.assert_allclose(more.acceleration, factor * same.acceleration)


def test_measure_prints_what_the_loopbacks_show(tmp_path: Path) -> None:
    bench = ("--port", "simulated", "--sensor", "simulated", "--flaws", "late=50us")
    words = ("measure", "reference-a", "-o", "bar.csv", *bench, "--places", "1", "--frequencies", "209")
    done = run_here(tmp_path, *words)
    told = re.search(r"channels, by their loopbacks: right plays \+(\S+) us after left, with (\S+) of its", done.stdout)
    assert told is not None, done.stdout
    assert [float(each) for each in told.groups()] == pytest.approx([50.0, 1.0], abs=0.002, rel=0.002)
    summary = summary_of(tmp_path, *words)
    assert list(summary["channels"]) == ["left", "right"]
