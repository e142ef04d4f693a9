"""From a protocol to report and curve by the command, with the simulated observer."""

import re
from pathlib import Path

import numpy as np
import pytest

from engine.device.threshold import read_threshold_file, shipped_threshold
from tactable.experiment.analysis import Answers, estimate_level, fit_track
from tests.tactable.cli.in_process import run_here


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def test_the_share_of_touches_that_kept_both_is_held_against_the_promise(folder: Path) -> None:
    words = ("experiment", "felt-and-quiet", "--observer", "threshold=2,slope=4")
    done = run_here(folder, *words)
    assert done.returncode == 0, done.stderr
    assert "SIMULATED" in done.stdout and "of 80 touches" in done.stdout and "at least as promised" in done.stdout
    other = run_here(folder, *words[:3], "threshold=13", "--participant", "02").stdout
    assert "less than the promise" in other
    again = run_here(folder, *words)
    assert again.stdout == done.stdout and "goes on after 266 of 266" in again.stderr


def test_tones_make_a_curve_that_other_commands_take(folder: Path) -> None:
    done = run_here(folder, "experiment", "threshold-curve", "--observer", "threshold=5,slope=4,lapse=0")
    assert done.returncode == 0, done.stderr
    curve = read_threshold_file(folder / "experiment/sub-01_task-thresholdcurve_threshold.toml")
    hz = np.array(curve.measured_hz)
    found = re.findall(r"\((\d+) Hz\) \| finger \| 60 \| (-?[0-9.]+) dB \(", done.stdout)
    reported = np.array(sorted((float(each), float(level_db)) for each, level_db in found))
    np.testing.assert_allclose(hz, reported[:, 0], atol=0.5)
    moved_db = 20 * np.log10(curve.peak_m_per_s2(hz) / shipped_threshold("oh-choi-2019").peak_m_per_s2(hz))
    np.testing.assert_allclose(moved_db, reported[:, 1], atol=0.06)
    checked = run_here(folder, "check", "reference-a", "--threshold", str(next(folder.rglob("*_threshold.toml"))))
    assert checked.returncode == 0 and "participant-01" in checked.stdout, checked.stderr


def test_a_level_beyond_the_device_is_refused_before_the_first_trial(folder: Path) -> None:
    text = 'name = "x"\n[[task]]\nname = "a"\nkind = "which-finger"\nfingers = ["35 mm", "120 mm"]\ntrials = 4\n'
    (folder / "x.toml").write_text(text + 'levels = ["0 dB", "30 dB"]\n', encoding="utf-8")
    done = run_here(folder, "experiment", "x.toml")
    assert done.returncode == 1 and "task a: 30 dB at 35 mm: the device reference-a reaches" in done.stderr
    assert not (folder / "experiment").exists()
    tone = text.replace("which-finger", "detection").replace(', "120 mm"', "") + 'stimulus = "tone"\n'
    (folder / "x.toml").write_text(tone + 'levels = ["0 dB", "26 dB"]\n', encoding="utf-8")
    assert "has no one threshold; lower the highest" in run_here(folder, "experiment", "x.toml").stderr


def test_catch_trials_alone_tell_of_bias_and_nothing_of_the_threshold() -> None:
    x_db, count = np.arange(-10.0, 21.0), 40
    zeros = np.zeros(count)
    nothing = Answers(zeros, zeros.astype(bool), zeros, zeros, np.ones(count, dtype=bool))
    posterior, others = fit_track(nothing, x_db)
    np.testing.assert_allclose(posterior.sum(axis=1), 1 / len(posterior), rtol=1e-9)
    assert others["bias"].argmax() == len(others["bias"]) - 1
    low, middle, high = estimate_level(posterior, x_db, 0.5)
    assert low == pytest.approx(-15, abs=1) and middle == pytest.approx(5, abs=1) and high == pytest.approx(25, abs=1)


def test_a_plan_says_how_long_and_how_precise(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactable.experiment.observer._OBSERVERS", 2)
    done = run_here(folder, "experiment", "felt-and-quiet", "--plan")
    assert done.returncode == 0 and "266 trials, about" in done.stdout and "which, trials of a track" in done.stdout
    widths = [float(width) for width in re.findall(r"([0-9.]+) dB with", done.stdout.splitlines()[-1])]
    assert len(widths) == 5 and widths[0] > widths[2] > widths[4] and not (folder / "experiment").exists()
