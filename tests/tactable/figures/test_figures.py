"""The figures: what they draw is what the table promises, what other models give, and what the search claims."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from engine.device import Device
from engine.table import Table
from engine.touch import Placement
from precompute.builder.table_build import build_table
from precompute.model.assembly import assemble
from precompute.model.steady import compute_steady_state
from tactable.explain.placed_drive import designer_of
from tactable.figures.course import compute_rising
from tactable.figures.factor import PairDrive, compute_factor
from tactable.figures.picture_file import Picture, write_picture
from tactable.figures.state_picture import PlayedDrive, compute_envelope, plot_state, solved_drive
from tests.small_device import small_text
from tests.tactable.figures.pictures import check_picture


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Table]:
    path = tmp_path_factory.mktemp("table") / "bar.nc"
    build_table(Device.parse(small_text("reference-a"), "bar.toml"), path, created="test", clicks_up_to=0)
    with Table.open(path) as table:
        yield table


def drawn(table: Table, felt: str, *quiet: str, level_db: float = 20.0) -> PlayedDrive:
    return solved_drive(designer_of(table), Placement.named(table.device, [felt], quiet), level_db)


def test_a_level_that_is_not_achieved_is_said(table: Table, tmp_path: Path) -> None:
    loudest_db = drawn(table, "I", "III", level_db=inf).drive.weakest_felt_db
    picture = plot_state(drawn(table, "I", "III", level_db=loudest_db + 3))
    check_picture(picture, table.device, {"drive"}, tmp_path)
    assert "NOT ACHIEVED" in picture.caption
    assert picture.summary["achieved"] is False


def test_a_drive_for_positions_is_drawn_at_them_as_it_was_solved(table: Table) -> None:
    placement = Placement.named(table.device, ["35 mm"], ["120 mm", "80 mm"])
    played = solved_drive(designer_of(table), placement, 20.0)
    solved = table.drive_for(["35 mm"], ["120 mm", "80 mm"], 20.0)
    assert (played.drive.frequencies_hz, played.drive.amplitudes) == (solved.frequencies_hz, solved.amplitudes)
    envelope = compute_envelope(played)
    for finger in played.fingers:
        here = np.interp(finger.position_m.real, np.real(envelope.position_m), envelope.standard)
        assert here == pytest.approx(finger.acceleration_m_per_s2, rel=1e-3)
        assert finger.range_db[0] <= finger.level_db <= finger.range_db[1]
    picture = plot_state(played)
    assert [finger["position_m"] for finger in picture.summary["fingers"]] == list(placement.position_m)
    assert "35 mm (I) felt" in picture.caption
    risen_db = compute_rising(played).level_db[played.placement.felt[0], -1]
    assert risen_db == pytest.approx(played.drive.weakest_felt_db, abs=1.0)


def test_with_fingers_the_factor_is_that_of_the_steady_state_and_none_out_of_an_actuator_s_band(table: Table) -> None:
    left, right = table.device.actuators
    device = replace(table.device, actuators=(replace(left, band_hz=(100.0, 300.0)), right))
    middle_m = (device.zones[1].start_m + device.zones[1].stop_m) / 2
    plant, hz = assemble(device).with_fingers([middle_m], device.finger), device.sweep.frequency_hz
    factor = compute_factor(device, ["III"], ["II"], PairDrive((0, 1), (1.0, 0.6)))
    below = hz < 100.0
    assert np.isnan(factor[below]).all()
    assert np.isfinite(factor[~below]).all()
    for first, second in ((30, 40), (40, 3), (25, 25)):
        steady = compute_steady_state(plant, hz[[first, second]], np.array([1.0, 0.6], dtype=np.complex128))
        assert factor[first, second] == pytest.approx(steady.share[2], rel=1e-8)


def small_picture() -> Picture:
    figure = Figure(figsize=(2, 2))
    axes = figure.add_subplot(xlabel="place (mm)", title="a drive")
    axes.plot([0, 1], [1, 0], label="level")
    axes.legend()
    return Picture(figure, {}, {}, "")


def test_the_same_data_are_the_same_file(tmp_path: Path) -> None:
    pictures = [small_picture() for _ in range(2)]
    for ending, magic in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".PDF", b"%PDF")):
        paths = [tmp_path / f"{k}{ending}" for k in range(2)]
        for picture, path in zip(pictures, paths, strict=True):
            write_picture(picture, path)
        first, second = (path.read_bytes() for path in paths)
        assert first.startswith(magic)
        assert first == second


def test_a_picture_that_cannot_be_drawn_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, figure = tmp_path / "kept.png", Figure()
    path.write_bytes(b"before")

    def broken(where: Path, **_unused: object) -> None:
        where.write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(figure, "savefig", broken)
    with pytest.raises(OSError, match="no space"):
        write_picture(Picture(figure, {}, {}, ""), path)
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"before"]
