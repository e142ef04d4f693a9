"""`measure` and `verify` with the board's own accelerometer: in virtual time, and over the terminal of `emulate`."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind, lay_out
from tests.engine.loop.rig import DEVICE
from tests.tactable.cli.in_process import run_here, summary_of
from tests.tactable.rig.test_emulate import emulator

pytestmark = pytest.mark.long

AT_MM, MASS_KG, HZ = 50, 2e-3, 209.0
SIMULATED = ("--port", "simulated", "--sensor", "board")


def errors_of(path: Path) -> list[tuple[float, float]]:
    """Error in dB and degrees of each measured response, against the finite elements with the sensor on the bar."""
    found = read_measurements(path, DEVICE, MASS_KG)
    assert found.is_simulated
    assert found.kind is Kind.RESPONSE
    layout = lay_out(found.frequency_hz, found.position_m[:1], MASS_KG, Kind.RESPONSE)
    predicted = MeasurementModel(DEVICE, layout, ()).predict(np.zeros(0)).log_acceleration
    ratios = found.acceleration / (found.amplitude.sum(axis=1) * np.exp(predicted))
    return [(20 * math.log10(abs(ratio)), math.degrees(np.angle(ratio))) for ratio in ratios]


@pytest.mark.machine
def test_a_board_over_a_terminal_is_measured_by_its_own_accelerometer(tmp_path: Path) -> None:
    spec = f"at={AT_MM}mm, mass=2g, drift=9000"
    with emulator(tmp_path, "--device", "reference-a", "--sensor", spec, "--seed", "5") as running:
        port = ("--port", running.line()["port"], "--sensor", f"board:{AT_MM}mm", "--bit-rate", "1000000")
        # At full drive the noise of the part is no cause to repeat a reading.
        words = ("--frequencies", f"{HZ:g}", "--least", "100 %")
        (tmp_path / "bar.csv").unlink(missing_ok=True)
        summary = summary_of(tmp_path, "measure", "reference-a", "-o", "bar.csv", *port, *words)
    assert (summary["places"], summary["readings"], summary["spoiled"]) == (1, 2, 0)
    assert summary["drift_ppm"] == pytest.approx(9_000, abs=5)
    errors = errors_of(tmp_path / "bar.csv")
    assert len(errors) == 2
    assert max(abs(db) for db, _ in errors) < 0.2
    assert max(abs(degrees) for _, degrees in errors) < 1.5


def test_a_simulated_bar_is_swept_by_the_board_s_own_accelerometer_whose_gain_gravity_shows(tmp_path: Path) -> None:
    words = ("--places", "1", "--frequencies", "209", "--method", "sweep", "--least", "100 %", "--json")
    flaws = ("--gravity", "--flaws", "drift=-15000,gain=4%")
    done = run_here(tmp_path, "measure", "reference-a", "-o", "bar.csv", *SIMULATED, *words, *flaws)
    assert done.returncode in (0, 3), done.stderr
    summary = json.loads(done.stdout)
    assert summary["drift_ppm"] == pytest.approx(-15_000, abs=5)
    assert summary["gravity"]["gain"] == pytest.approx(0.04, abs=3e-3)
    assert set(summary["faults"]) <= {"CLOCK_DRIFT", "NOISE", "LATENCY"}
    assert summary["lost"] == {"frames": 0, "samples": 0}
