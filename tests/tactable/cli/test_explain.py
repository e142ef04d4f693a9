"""The commands `explain` and `diff`: the contract of their JSON, their pages, and the exit status of `diff`."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from engine.steady.steady_drive import compute_levels
from engine.table import Table
from engine.touch import Placement
from precompute.clicks import ClickSolver
from precompute.clicks.click_options import read_click_options
from precompute.clicks.evaluation import decibels
from precompute.predict.at_positions import SteadyDesigner
from tactable.cli.main import app
from tests.engine.made_table import write_table
from tests.engine.table.test_table import DEVICE
from tests.engine.table.test_table_diff import CLICKS, held, rows_of
from tests.tactable.cli.in_process import run_here, summary_of

ROWS = rows_of(DEVICE)
WORDS = ("explain", "bar.nc", "--felt", "35 mm", "--quiet", "120 mm")


@pytest.fixture
def told(click_table: Path) -> Callable[..., Any]:
    """What `tactable` tells in JSON for these words in the folder of the table."""
    return partial(summary_of, click_table.parent)


@pytest.fixture
def page(click_table: Path) -> Callable[..., str]:
    """What `tactable` prints for these words in the folder of the table."""

    def page(*words: str) -> str:
        done = run_here(click_table.parent, *words)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return page


def test_a_click_for_positions_is_told_as_it_would_be_played_at_its_level(click_table: Path, told: Any) -> None:
    said = told(*WORDS, "--click", "--level", "0")
    assert [(each["position_m"], each["role"]) for each in said["fingers"]] == [(0.035, "felt"), (0.12, "quiet")]
    for kind in ("felt_db", "quiet_db"):
        assert said[kind].keys() == {"nominal", "5 %", "50 %", "95 %"}
    assert said["felt_db"]["5 %"] == pytest.approx(0.0, abs=1e-6)
    with Table.open(click_table) as table:
        solver = ClickSolver(table.device, replace(read_click_options(table), tolerance_m=1e-3))
        placement = Placement.on(table.device, [0.035], [0.12])
        waveform = np.array(said["waveform"])
        assert waveform.shape == (len(table.device.actuators), round(said["length_s"] * said["sample_rate_hz"]) + 1)
        assert abs(waveform).max() <= table.device.limits.amplitude
        # What is told of the nominal plant is what the waveform does there.
        nominal = solver.plants_of(placement.position_m).judged.first(1)
        assert decibels(nominal.peaks(waveform, [0, 1]))[0] == pytest.approx(
            [said["felt_db"]["nominal"], said["quiet_db"]["nominal"]], abs=1e-3
        )
    assert "Oh and Choi" in said["threshold"] and said["options"]["tolerance_m"] == 1e-3


def test_zones_are_told_by_the_played_row_and_what_fingers_get_of_it(click_table: Path, told: Any, page: Any) -> None:
    words = ("explain", "bar.nc", "--felt", "I", "--quiet", "III", "--drives", "zones")
    said = told(*words)
    with Table.open(click_table) as table:
        row, modes = table.best_row(["I"]), table.modes
        middles_m = [(zone.start_m + zone.stop_m) / 2 for zone in table.device.zones]
        played = (row.frequencies_hz, row.complex_amplitudes)
        nominal_db = compute_levels(table.device, modes, [middles_m[0], middles_m[2]], *played)[0]
    assert said["felt_zones"] == ["I"] and said["row"] == {"group": row.group, "index": row.index}
    assert said["drive"]["frequencies_hz"] == list(row.frequencies_hz)
    assert [zone["share"] for zone in said["zones"].values()] == pytest.approx(row.shares)
    assert [each["level_db"]["nominal"] for each in said["fingers"]] == pytest.approx(nominal_db)
    assert f"row {row.index} of {row.group}" in page(*words)
    # The same fingers by positions get what is solved for the middles of their zones.
    said = told(*words[:-1], "positions")
    assert [each["position_m"] for each in said["fingers"]] == pytest.approx([middles_m[0], middles_m[2]])
    assert said["contrast_db"] == pytest.approx(np.subtract(*[each["level_db"]["nominal"] for each in said["fingers"]]))


def test_a_persons_curve_solves_the_drive_for_that_person(click_table: Path, told: Any, page: Any) -> None:
    words = (*WORDS, "--level", "6", "--threshold", "android")
    said = told(*words)
    assert "Android" in said["threshold"]
    with Table.open(click_table) as table:
        device, hz = table.device.with_threshold("android"), np.array(said["drive"]["frequencies_hz"][:1])
        solver = SteadyDesigner(device, samples=2)  # it solves its own modes, at this curve
    drive = solver.solver.solve((0.035, 0.12), (True, False), 6.0)
    assert drive.frequencies_hz[0] == pytest.approx(hz[0])
    assert list(drive.amplitudes) == pytest.approx(said["drive"]["amplitudes"], rel=1e-3)
    felt, quiet = said["fingers"]
    assert (felt["position_m"], felt["role"], quiet["position_m"], quiet["role"]) == (0.035, "felt", 0.12, "quiet")
    assert felt["level_db"].keys() == {"nominal", "5 %", "50 %", "95 %"}
    assert felt["level_db"]["nominal"] == pytest.approx(6.0, abs=0.05) == said["level_db"]
    shown = page(*words)
    assert "dB above threshold android" in shown and "Oh and Choi" not in shown


def test_a_harder_finger_and_temporal_summation_are_asked_for_and_said(told: Any, page: Any) -> None:
    words = (*WORDS, "--level", "6")
    assert "at 2 N (assumed)" in page(*words) and "at 8 N," in page(*words, "--threshold", "oh-choi-2019, 8 N")
    soft, hard = (
        told(*words, "--threshold", f"oh-choi-2019, {force}")["drive"]["amplitudes"] for force in ("2 N", "8 N")
    )
    assert max(hard) != pytest.approx(max(soft), rel=0.05)
    peaks, summed = (told(*WORDS, "--click", "--summation", name) for name in ("none", "zwislocki-1960"))
    assert (peaks["temporal_summation"], summed["temporal_summation"]) == ("none", "zwislocki-1960")
    for one, other in zip(peaks["fingers"], summed["fingers"], strict=True):
        assert 6 < one["level_db"]["50 %"] - other["level_db"]["50 %"] < 20
    assert peaks["felt_db"] == summed["felt_db"]  # what is promised stays that of peaks


@pytest.mark.parametrize("kind", [(), ("--click",), ("--click", "--level", "full")])
def test_the_page_names_positions_roles_and_the_threshold_curve(page: Any, kind: tuple[str, ...]) -> None:
    shown = page(*WORDS, *kind)
    fingers = "35 mm (I) felt, 120 mm (II) quiet"
    for part in (fingers, "solved for these positions", "Oh and Choi 2019", "ESTIMATES", "1 mm"):
        assert part in shown


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    folder = tmp_path_factory.mktemp("tables")
    before = write_table(folder / "before.nc", DEVICE, CLICKS, rows=held(ROWS))
    rows = held([ROWS[0], replace(ROWS[1], level_db=18.5), *ROWS[2:]])
    after = write_table(folder / "after.nc", DEVICE, CLICKS[:2], rows=rows, source="measured")
    return str(before), str(after)


def diff(*words: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["diff", *words])
    return done.exit_code, done.stdout, done.stderr


def test_the_status_is_0_for_the_same_1_for_others_and_2_for_trouble(tables: tuple[str, str]) -> None:
    before, after = tables
    assert diff(before, before)[0] == 0
    assert diff(before, after)[0] == 1
    for words in ((before, "no-such.nc"), (before, __file__), (before,), (before, after, "--limit", "-1")):
        assert diff(*words)[0] == 2, words
    _, out, errors = diff(before, "no-such.nc")
    assert not out
    assert errors.startswith("tactable: no-such.nc: ")
    assert errors.count("\n") == 1


def test_words_and_figures_say_what_changed(tables: tuple[str, str]) -> None:
    out = diff(*tables)[1]
    for part in ("the tables differ", "option: source: measured appeared", "felt IV at 20 dB: level 20 -> 18.5 dB"):
        assert part in out
    assert "best rows: 1 of 6 changed beyond 0.1 dB" in out and "clicks: none of 2 changed" in out
    assert "clicks: 1 vanished: felt 83.8 mm 139.7 mm, quiet 251.5 mm" in out
    out = diff(tables[0], tables[0])[1]
    assert "the tables are the same" in out and "best rows: none of 6 changed" in out
    assert "best rows: none of 6 changed" in diff(*tables, "--limit", "1.6")[1]
