"""Pictures of studies and of a calibration: what is drawn and written is what was found."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from engine.device import Device
from engine.device.parts import Plate
from precompute.studies.placement_search import (
    Placement,
    PlacementSearch,
    Resolved,
    TwoFingers,
    even_places,
    own_places,
)
from precompute.studies.robustness import CHANGES, Kept
from tactable.figures.placement_picture import plot_placement
from tactable.figures.resolution_picture import plot_resolution, plot_robustness
from tactable.figures.response_picture import plot_response
from tests.precompute.calibration.calibrations import noisy_calibration
from tests.precompute.devices import shipped
from tests.tactable.figures.pictures import check_picture

DEVICE: Device = shipped("reference-a")


def fingers(worst_db: float, level_db: float = 20.0) -> TwoFingers:
    contrast_db = np.full((5, 5), worst_db + 6.0)
    contrast_db[1, 3] = worst_db
    np.fill_diagonal(contrast_db, np.nan)
    return TwoFingers(20.0, contrast_db, np.where(np.isnan(contrast_db), np.nan, level_db))


def search(count: int, device: Device = DEVICE) -> PlacementSearch:
    screened_m = np.sort(np.random.default_rng(count).uniform(0.01, 0.17, (9, count)), axis=1)
    screened_m = screened_m + 1j * screened_m[:, ::-1] if isinstance(device.surface, Plate) else screened_m
    judged = [Placement("found", tuple(screened_m[0].tolist()), fingers(8.0 + count))]
    judged.append(Placement("even", even_places(device, count), fingers(3.0, 15.0)))
    if count == len(device.actuators):
        judged.append(Placement("as described", own_places(device), fingers(4.0)))
    return PlacementSearch(screened_m, np.append(np.linspace(-3.0, 7.0, 8), np.nan), 5, tuple(judged))


def resolved(actuators: int, zones: int, worst_db: float, level_db: float = 20.0) -> Resolved:
    length_m = DEVICE.bar.length_m / zones
    found = fingers(worst_db, level_db)
    return Resolved(even_places(DEVICE, actuators), zones, length_m, found, np.linspace(0.3, 0.9, zones))


STUDY = [resolved(2, 2, 14.0), resolved(2, 4, 11.0), resolved(2, 8, 6.0), resolved(3, 2, 9.0), resolved(3, 4, 12.0, 18)]


def test_every_placement_is_a_row_judged_ones_first(tmp_path: Path) -> None:
    picture = plot_placement(DEVICE, [search(2), search(3)], 20.0)
    check_picture(picture, DEVICE, ("placement",), tmp_path)
    columns = picture.columns
    screened = ["screened"] * 9
    assert list(columns["placement"]) == ["found", "even", "as described", *screened, "found", "even", *screened]
    assert list(columns["worst contrast (dB)"])[:3] == [10.0, None, 4.0], "a level out of reach has no contrast"
    assert list(columns["position 3 (m)"])[:12] == [None] * 12
    assert list(columns["position 1 (m)"])[1] == even_places(DEVICE, 2)[0]


def test_placements_of_a_plate_are_drawn_from_above_and_written_in_both_directions(tmp_path: Path) -> None:
    device = shipped("reference-p")
    picture = plot_placement(device, [search(3, device), search(4, device)], 20.0)
    check_picture(picture, device, ("placement",), tmp_path)
    assert len([axes for axes in picture.figure.axes if axes.patches and axes.axison]) == 5, (
        "a plate for each judged one"
    )
    own = picture.summary["searches"][1]["judged"][2]["position_percent"]
    assert own[0] == pytest.approx([10.0, 100 * 25 / 180])
    row = list(picture.columns["placement"]).index("as described")
    assert (picture.columns["position 1 (m)"][row], picture.columns["position 1 across (m)"][row]) == (0.03, 0.025)
    assert picture.columns["position 4 across (m)"][0] is None


def test_the_figure_has_a_line_a_placement_and_hollow_marks_where_a_level_is_missed(tmp_path: Path) -> None:
    picture = plot_resolution(DEVICE, STUDY, 20.0)
    check_picture(picture, DEVICE, ("placement",), tmp_path)
    left = picture.figure.axes[0]
    drawn = {str(line.get_label()): line for line in left.lines}
    assert np.asarray(drawn["2 at 25, 75 %"].get_ydata()).tolist() == [14.0, 11.0, 6.0]
    hollow = [line for line in left.lines if line.get_color() == "white" and np.size(line.get_xdata())]
    assert [np.asarray(line.get_ydata()).tolist() for line in hollow if np.size(line.get_ydata())] == [[12.0]]
    assert picture.summary["placements"][0]["narrowest_zone_m"] == pytest.approx(DEVICE.bar.length_m / 4)


def test_a_row_is_two_bars_and_its_contrast_and_a_panel_a_set(tmp_path: Path) -> None:
    kept = {
        "bench": [Kept(0.9, 0.98, 1.0, 14.9, 20.9), Kept(0.1, 0.5, 0.6, 8.0, 15.0)],
        "lab": [Kept(0.8, 0.9, 0.95, 12.0, 18.0)] * 2,
    }
    picture = plot_robustness(DEVICE, CHANGES[:2], kept, 200, 50)
    check_picture(picture, DEVICE, ("clicks made for", "what is different"), tmp_path)
    bench, lab = picture.figure.axes
    widths = [[bar.get_width() for bar in axes.patches if isinstance(bar, Rectangle)] for axes in (bench, lab)]
    assert widths == [pytest.approx([98, 50, 90, 10]), pytest.approx([90, 90, 80, 80])]
    assert [np.asarray(axes.lines[0].get_xdata()).tolist() for axes in (bench, lab)] == [[100, 60], [95, 95]]
    assert [text.get_text() for text in bench.texts] == ["14.9, 20.9", "8.0, 15.0"]
    assert "made for bench: at least 10 % keep quiet ≤ 1 dB, 50 % ≤ 6 dB; made for lab" in picture.caption
    assert list(picture.columns["what is different"]) == [change.name for change in CHANGES[:2]] * 2


def test_there_is_a_panel_for_every_drive_with_all_its_readings_and_the_wrong_ones_marked() -> None:
    found = noisy_calibration()
    figure = plot_response(found.device, found.measurements, has_readings=True, is_wrong=found.is_wrong).figure
    lines = [{line.get_label(): np.size(line.get_xdata()) for line in axes.lines} for axes in figure.axes[:3]]
    assert all(line["SIMULATED points"] == 22 for line in lines)
    assert sum(line["taken for wrong"] for line in lines) == found.is_wrong.sum() == 3
