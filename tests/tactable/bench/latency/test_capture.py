"""Captures of a scope that were made up: every delay comes back, and what is wrong is named by row and column."""

from pathlib import Path

import numpy as np
import pytest

from tactable.bench.latency.capture import capture_json, delays_of, read_capture, rising_edges
from tactable.bench.latency.report import LatencyReportError

RATE_HZ = 20_000
PERIOD_S = 0.25


def write_capture(path: Path, echo_s: list[float], felt_s: list[float], noise: float = 0.01) -> Path:
    """Touches each PERIOD_S; after each its echo and the onset of a 190 Hz vibration, NaN for none."""
    random = np.random.default_rng(1)
    time_s = np.arange(round(RATE_HZ * PERIOD_S * (len(echo_s) + 1))) / RATE_HZ
    touch, echo, acceleration = (random.normal(0.0, noise, len(time_s)) for _ in range(3))
    acceleration += 9.81
    for number, (echo_after_s, felt_after_s) in enumerate(zip(echo_s, felt_s, strict=True)):
        start_s = PERIOD_S * (number + 0.5)
        touch += 3.3 * ((time_s >= start_s) & (time_s < start_s + 0.1))
        echo += 3.3 * ((time_s >= start_s + echo_after_s) & (time_s < start_s + 0.1))
        since = time_s - start_s - felt_after_s
        acceleration += np.where((since >= 0) & (since < 0.05), 2.0 * np.sin(2 * np.pi * 190 * since), 0.0)
    rows = np.column_stack([time_s, touch, echo, acceleration])
    np.savetxt(path, rows, delimiter=",", fmt="%.6g", header="time_s,touch_v,echo_v,acceleration_m_per_s2", comments="")
    return path


def test_every_delay_comes_back_within_a_sample(tmp_path: Path) -> None:
    echo_s, felt_s = [0.010, 0.012, 0.020, 0.008], [0.014, 0.0155, 0.026, 0.010]
    delays = delays_of(read_capture(write_capture(tmp_path / "scope.csv", echo_s, felt_s)))
    assert delays["touch to echo"] / 1e9 == pytest.approx(echo_s, abs=1.1 / RATE_HZ)
    # A sine leaves six times the noise, 0.06 of 2 m/s^2, after 25 us.
    assert delays["touch to acceleration"] / 1e9 == pytest.approx(felt_s, abs=3 / RATE_HZ)
    assert delays["echo to acceleration"] == pytest.approx(delays["touch to acceleration"] - delays["touch to echo"])


def test_a_touch_without_an_answer_is_a_miss(tmp_path: Path) -> None:
    nan = float("nan")
    document = capture_json(read_capture(write_capture(tmp_path / "scope.csv", [0.01, nan, 0.01], [0.015, nan, 0.015])))
    (condition,) = document["conditions"]
    assert condition["misses"] == {"1 ms": 3, "5 ms": 3, "10 ms": 3, "20 ms": 1, "50 ms": 1}
    assert condition["stages"]["touch to acceleration"]["count"] == 2
    assert "3 touches, 1 of them without an answer" in document["method"]
    assert document["simulated"] == []


def test_a_threshold_that_is_given_decides(tmp_path: Path) -> None:
    capture = read_capture(write_capture(tmp_path / "scope.csv", [0.01], [0.015]))
    (found_ns,) = delays_of(capture, threshold=1.0)["touch to acceleration"]
    # sin reaches half after a twelfth of its period
    assert found_ns / 1e9 == pytest.approx(0.015 + 1 / 190 / 12, abs=2 / RATE_HZ)


def test_noise_at_an_edge_is_one_edge() -> None:
    values = np.array([0.0, 0.1, 0.5, 0.45, 0.55, 0.5, 1.0, 0.9, 0.5, 0.55, 1.0, 0.0, 0.0, 1.0, 1.0])
    assert rising_edges(values).tolist() == [6, 13]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,touch\n0,0\n", "row 1: columns time_s, touch; expected time_s, touch_v"),
        ("time_s,touch_v,echo_v\n0,0,0\n1,x,0\n", "row 3, touch_v: 'x' is no number"),
        ("time_s,touch_v,echo_v\n0,0,0\n1,0\n", "row 3: 2 values; expected 3"),
        ("time_s,touch_v,echo_v\n1,0,0\n0,0,0\n", "whose time_s rises"),
        ("", "row 1"),
    ],
)
def test_what_is_wrong_is_named_by_row_and_column(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "scope.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(LatencyReportError, match=said):
        read_capture(path)


def test_a_capture_without_a_touch_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scope.csv"
    path.write_text("time_s,touch_v,echo_v\n" + "".join(f"{i},0,0\n" for i in range(50)), encoding="utf-8")
    with pytest.raises(LatencyReportError, match="touch_v never rises"):
        delays_of(read_capture(path))
