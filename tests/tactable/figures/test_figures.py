"""The figures: what they draw is what the table promises, what models and readings give, and what the search claims."""

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
from precompute.measurements.model import Flaws, even_places, simulate_measurements
from precompute.measurements.types import Measurements, lay_out
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from tactable.explain.placed_drive import designer_of
from tactable.figures.course import compute_rising
from tactable.figures.picture_file import Picture, write_picture
from tactable.figures.response_picture import plot_response, reading_at
from tactable.figures.state_picture import PlayedDrive, compute_envelope, plot_state, solved_drive
from tactable.figures.style import surface_field
from tests.precompute.devices import shipped
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


DEVICE = shipped("reference-a")
NAN = np.nan


def drives(*hz: tuple[float, float]) -> Measurements:
    return lay_out(np.array(hz), np.zeros(1), 0.0)


def readings(*hz: tuple[float, float]) -> Measurements:
    return simulate_measurements(DEVICE, lay_out(np.array(hz), even_places(DEVICE), 2e-3), Flaws(), seed=0)


def test_noiseless_readings_lie_on_the_curve_that_has_the_sensor_at_each_place() -> None:
    read = readings((150.0, 130.0), (NAN, 200.0))
    picture = plot_response(DEVICE, read, has_readings=True)
    assert np.asarray(picture.columns["computed (m/s^2)"]) == pytest.approx(abs(read.acceleration), rel=1e-6)
    place_m, first = surface_field(DEVICE).position_m.real, slice(0, 22)
    level = reading_at(DEVICE, read, 0, place_m)
    assert np.interp(read.position_m[first].real, place_m, level) == pytest.approx(
        abs(read.acceleration[first]), rel=0.01
    )
    bare = reading_at(DEVICE, drives((150.0, 130.0)), 0, place_m)
    assert abs(level / bare - 1).max() > 0.1, "2 g are felt on this bar"


def test_what_is_simulated_says_so_and_what_is_measured_does_not() -> None:
    read = readings((150.0, 130.0))
    for is_simulated, what in ((True, "SIMULATED"), (False, "measured.")):
        picture = plot_response(DEVICE, replace(read, is_simulated=is_simulated), has_readings=True)
        assert ("SIMULATED" in picture.caption) is is_simulated
        assert picture.figure.get_supxlabel().startswith(f"Curves computed, points {what}")
        labels = {line.get_label() for axes in picture.figure.axes for line in axes.lines}
        assert labels >= {"computed, with the sensor at each place"} and ("measured" in labels) is not is_simulated


def test_readings_of_a_plate_lie_on_the_map_that_has_the_sensor_at_each_place() -> None:
    plate, hz = shipped("reference-c"), np.array([(150.0, 130.0, NAN)])
    read = simulate_measurements(plate, lay_out(hz, surface_field(plate, 12).position_m, 2e-3), Flaws(), seed=0)
    picture = plot_response(plate, read, has_readings=True)
    assert np.asarray(picture.columns["computed (m/s^2)"]) == pytest.approx(abs(read.acceleration), rel=1e-6)
    assert np.asarray(picture.columns["position, across (m)"]) == pytest.approx(read.position_m.imag)
    bare = plot_response(plate, lay_out(hz, np.zeros(1), 0.0), has_readings=False)
    (drive,) = bare.summary["drives"]
    at_m = np.array([complex(*drive["greatest_position_m"])])
    field = solve_response(assemble(plate), np.array([130.0, 150.0])).acceleration(at_m)[..., 0]
    assert drive["greatest_m_per_s2"] == pytest.approx(abs(field[1, 0]) + abs(field[0, 1]), rel=1e-3)
    assert "nodes_m" not in drive
