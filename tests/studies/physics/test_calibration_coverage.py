"""The study of calibrations: true values within the limits they are drawn from, figures of every case, a picture."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.precompute.devices import shipped
from tests.precompute.measured import TRUTH
from tests.studies.physics.calibration_coverage import Case, describe, draw, draw_truth, measure_coverage


@cache
def result() -> dict[str, Any]:
    return measure_coverage((Case("reference-a", 3, 0.01), Case("reference-a", 3, 0.0, published=True)), 1)


@pytest.mark.long
def test_every_case_has_its_figures_and_json_takes_them() -> None:
    noisy, clean = json.loads(json.dumps(result(), allow_nan=False))["cases"]
    assert [p["name"] for p in noisy["parameters"]] == list(TRUTH)
    assert max(p["greatest_error"] for p in clean["parameters"] if p["name"] != "bar.mass_damping") < 1e-6
    assert 0 <= noisy["held"] <= 1
    assert noisy["seconds"]["greatest"] >= noisy["seconds"]["median"] > 0


def test_bars_are_drawn_about_the_device_by_their_seed() -> None:
    device, names = shipped("reference-a"), tuple(TRUTH)
    first, again, other = (draw_truth(device, names, seed, published=False) for seed in (3, 3, 4))
    assert (first == again).all() and (first != other).all()
    many = np.array([draw_truth(device, names, seed, published=False) for seed in range(200)])
    assert many[:, 4].min() >= 0.3 and many[:, 4].max() <= 10
    assert many[:, 0].min() >= 0.75 * 18.9e3 and many[:, 0].max() <= 1.3 * 18.9e3
    assert draw_truth(device, names, 3, published=True)[4] == device.bar.mass_damping_per_s


def test_the_study_is_described_and_drawn(tmp_path: Path) -> None:
    assert [("as published" in describe(row)) for row in result()["cases"]] == [False, True]
    draw(result(), tmp_path / "held.png")
    assert (tmp_path / "held.png").stat().st_size > 10_000
