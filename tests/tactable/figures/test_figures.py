"""The figures: what they draw is what the table promises, what other models give, and what the search claims."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from engine.table import Table, TableError
from engine.touch import Placement, ZoneState
from precompute.model.assembly import assemble
from precompute.model.steady import compute_steady_state
from tactable.figures.contrast_map import plot_contrast_map
from tactable.figures.course import compute_rising, plot_course
from tactable.figures.factor import PairDrive, compute_factor, pair_drive, plot_factor, read_factor
from tactable.figures.file import FigureError, Picture, check_paths, write_picture
from tactable.figures.pareto import STEP_DB, Front, plot_pareto, solve_front, solve_paper_drive
from tactable.figures.played_drive import entry_drive, solved_drive
from tactable.figures.rise import plot_rise
from tactable.figures.state import compute_envelope, plot_state
from tests.quick import first_quick
from tests.tactable.figures.pictures import check_picture
from tests.tactable.plot_table import build_small_table

SEARCH_DB = 0.05
"""The entries' own claim: so far from the optimum at most (tests/precompute)."""


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Table]:
    with Table.open(build_small_table(tmp_path_factory.mktemp("table"))) as table:
        yield table


@pytest.fixture(scope="module")
def state(table: Table) -> tuple[ZoneState, ...]:
    return table.states_of(["I"], ["III"])


@pytest.fixture(scope="module")
def front(table: Table, state: tuple[ZoneState, ...]) -> Front:
    return solve_front(table.device, state, "contrast")


@pytest.fixture(scope="module")
def paper(table: Table, state: tuple[ZoneState, ...]) -> Front:
    return solve_paper_drive(table.device, state)


@pytest.mark.parametrize("every", first_quick([5, 1]))
def test_the_envelope_under_a_standard_finger_is_what_the_entry_promises(table: Table, every: int) -> None:
    for entry in list(table.entries_at(20.0))[::every]:
        envelope = compute_envelope(entry_drive(table, entry))
        for zone, promise in zip(table.device.zones, entry.zones, strict=True):
            if promise.acceleration_at_finger_m_per_s2 is not None:
                here = np.interp((zone.start_m + zone.stop_m) / 2, envelope.position_m, envelope.standard)
                assert here == pytest.approx(promise.acceleration_at_finger_m_per_s2, rel=1e-6)


def test_the_band_holds_the_levels_that_the_entry_gives_for_other_fingers(table: Table) -> None:
    entry, device = table.entry_for(["I"], ["III"]), table.device
    envelope = compute_envelope(entry_drive(table, entry))
    threshold = float(table.device.threshold.peak_m_per_s2(np.array(entry.frequencies_hz[:1]))[0])
    assert (envelope.least <= envelope.standard).all()
    assert (envelope.standard <= envelope.greatest).all()
    for zone, promise in zip(device.zones, entry.zones, strict=True):
        if promise.sensation_level_range_db is not None:
            least, greatest = (threshold * 10 ** (level_db / 20) for level_db in promise.sensation_level_range_db)
            inside = (envelope.position_m >= zone.start_m) & (envelope.position_m <= zone.stop_m)
            assert envelope.least[inside].min() <= least
            assert envelope.greatest[inside].max() >= greatest


def test_a_state_that_is_not_achieved_says_so(table: Table) -> None:
    loudest_db = table.entry_for(["I"], ["III"], inf).level_db
    picture = plot_state(entry_drive(table, table.entry_for(["I"], ["III"], loudest_db + 3)))
    assert "NOT ACHIEVED" in picture.caption
    assert picture.summary["achieved"] is False


def test_every_tone_has_its_threshold(table: Table) -> None:
    entry = replace(table.entry_for(["I"], ["III"]), frequencies_hz=(100.0, 200.0))
    thresholds = plot_state(entry_drive(table, entry)).summary["threshold_m_per_s2"]
    assert thresholds == {
        hz: pytest.approx(float(table.device.threshold.peak_m_per_s2(np.array([float(hz)]))[0])) for hz in thresholds
    }
    assert list(thresholds) == ["100.0", "200.0"]


def test_a_drive_for_positions_is_drawn_at_them_as_it_was_solved(table: Table) -> None:
    placement = Placement.named(table.device, ["35 mm"], ["120 mm", "80 mm"])
    drawn = solved_drive(table, placement, 20.0)
    solved = table.drive_for(["35 mm"], ["120 mm", "80 mm"], 20.0)
    assert (drawn.frequencies_hz, drawn.amplitudes) == (solved.frequencies_hz, solved.amplitudes)
    envelope = compute_envelope(drawn)
    for finger in drawn.fingers:
        here = np.interp(finger.position_m, envelope.position_m, envelope.standard)
        assert here == pytest.approx(finger.acceleration_m_per_s2, rel=1e-3)
        assert finger.range_db[0] <= finger.level_db <= finger.range_db[1]
    picture = plot_state(drawn)
    assert [finger["position_m"] for finger in picture.summary["fingers"]] == list(placement.position_m)
    assert "35 mm (I) felt" in picture.caption
    risen_db = compute_rising(drawn).level_db[drawn.placement.felt[0], -1]
    assert risen_db == pytest.approx(drawn.level_db, abs=1.0)


def test_the_front_passes_through_the_entries_of_the_table(table: Table, front: Front) -> None:
    for level_db in table.levels_db:
        entry = table.entry_for(["I"], ["III"], level_db)
        at = int(abs(front.level_db - entry.level_db).argmin())
        assert front.level_db[at] == pytest.approx(entry.level_db, abs=1e-3)
        assert front.expected_db[at] == pytest.approx(entry.expected_contrast_db, abs=SEARCH_DB)


def test_the_papers_drive_has_the_greatest_factor_of_the_untouched_bar_and_less_contrast_with_fingers(
    table: Table, front: Front, paper: Front
) -> None:
    plant = assemble(table.device)

    def untouched_factor(drives: Front, k: int) -> float:
        return float(compute_steady_state(plant, drives.frequency_hz[k], drives.amplitude[k]).share[0])

    every = [untouched_factor(front, k) for k in range(len(front.level_db))]
    assert untouched_factor(paper, 0) > max(every)
    as_loud = front.level_db >= paper.level_db[0]
    assert paper.expected_db[0] < front.expected_db[as_loud][0]


def test_contrast_without_a_quiet_finger_is_refused(table: Table) -> None:
    with pytest.raises(TableError, match="--quiet IV"):
        plot_pareto(table, table.states_of(["I"], []))


def test_the_levels_of_the_front_are_a_step_apart(front: Front) -> None:
    assert np.diff(front.level_db)[:-1] == pytest.approx(STEP_DB)


@pytest.mark.parametrize("level_db", [20.0, 33.0, inf])
def test_the_map_shows_the_entries(table: Table, level_db: float) -> None:
    columns = plot_contrast_map(table, level_db).columns
    for k, (felt, quiet) in enumerate(zip(columns["felt zone"], columns["quiet zone"], strict=True)):
        entry = table.entry_for([felt], [quiet] if quiet else [], level_db)
        assert columns["expected contrast (dB)"][k] == entry.expected_contrast_db
        assert columns[f"level (dB {table.device.threshold.above})"][k] == entry.level_db
    assert list(columns["quiet zone"]).count("") == 3


def test_what_is_not_achieved_is_hatched(table: Table) -> None:
    loudest_db = [table.entry_for([zone.name], [], inf).level_db for zone in table.device.zones]
    picture = plot_contrast_map(table, max(loudest_db) + 1)
    hatched = [patch for patch in picture.figure.axes[0].patches if patch.get_hatch()]
    missed = [reached for row in picture.summary["achieved"] for reached in row if not reached]
    assert len(hatched) == len(missed) == 9
    assert not [patch for patch in plot_contrast_map(table, 20.0).figure.axes[0].patches if patch.get_hatch()]


@pytest.mark.parametrize("level_db", [20.0, 33.0, inf])
def test_the_rise_times_are_those_of_the_entries(table: Table, level_db: float) -> None:
    columns = plot_rise(table, level_db).columns
    assert len(columns["t90 (s)"]) == 19  # every state of three zones with a felt finger
    for k, (felt, quiet) in enumerate(zip(columns["felt zones"], columns["quiet zones"], strict=True)):
        entry = table.entry_for(str(felt).split(), str(quiet).split(), level_db)
        assert columns["t90 (s)"][k] == entry.t90_s
        assert columns["worst t90 (s)"][k] == entry.worst_case.t90_s >= entry.t90_s


def test_the_course_of_a_state_is_risen_when_its_entry_says_and_stays_near_what_it_promises(table: Table) -> None:
    for felt, quiet in ((["I"], []), (["III"], ["I"]), (["I"], ["II", "III"])):
        entry = table.entry_for(felt, quiet, 20.0)
        drawn = entry_drive(table, entry)
        rising = compute_rising(drawn)
        (finger,) = drawn.placement.felt
        own, promised_db = rising.level_db[finger], drawn.fingers[finger].level_db
        outside = np.flatnonzero(abs(10 ** ((own - promised_db) / 20) - 1) > 0.1)
        assert rising.time_s[outside[-1]] == pytest.approx(entry.t90_s, abs=2e-3)


def test_the_contrast_of_a_course_is_felt_over_quiet_at_each_moment(table: Table) -> None:
    entry = table.entry_for(["I"], ["II", "III"], 20.0)
    columns = plot_course(entry_drive(table, entry)).columns
    level_db = {
        name: np.asarray(columns[f"level of {name} (dB {table.device.threshold.above})"])
        for name in ("46.57 mm (I) felt", "139.7 mm (II) quiet", "232.8 mm (III) quiet")
    }
    felt_db, *quiet_db = level_db.values()
    assert np.asarray(columns["contrast (dB)"]) == pytest.approx(felt_db - np.maximum(*quiet_db))
    assert "contrast (dB)" not in plot_course(entry_drive(table, table.entry_for(["I"], [], 20.0))).columns


@pytest.mark.parametrize("amplitudes", [(1.0, 1.0), (1.0, 0.4), (0.0, 1.0)])
def test_without_fingers_the_factor_is_that_of_the_sweep(table: Table, amplitudes: tuple[float, float]) -> None:
    drive = PairDrive((0, 1), amplitudes)
    computed = compute_factor(table.device, ["I", "III"], [], drive)
    assert computed == pytest.approx(read_factor(table, ["I", "III"], drive), abs=2e-6)


def test_with_fingers_the_factor_is_that_of_the_steady_state(table: Table) -> None:
    device = table.device
    middle_m = (device.zones[1].start_m + device.zones[1].stop_m) / 2
    plant, hz = assemble(device).with_fingers([middle_m], device.finger), device.sweep.frequency_hz
    factor = compute_factor(device, ["III"], ["II"], PairDrive((0, 1), (1.0, 0.6)))
    for first, second in ((3, 40), (40, 3), (25, 25)):
        steady = compute_steady_state(plant, hz[[first, second]], np.array([1.0, 0.6], dtype=np.complex128))
        assert factor[first, second] == pytest.approx(steady.share[2], rel=1e-8)


def test_out_of_its_band_an_actuator_has_no_factor(table: Table) -> None:
    left, right = table.device.actuators
    device = replace(table.device, actuators=(replace(left, band_hz=(100.0, 300.0)), right))
    factor = compute_factor(device, ["I"], [], PairDrive((0, 1), (1.0, 1.0)))
    below = device.sweep.frequency_hz < 100.0
    assert np.isnan(factor[below]).all()
    assert np.isfinite(factor[~below]).all()


def test_every_zone_has_a_panel_and_its_share_and_they_add_up_to_what_covers_the_bar(table: Table) -> None:
    drive = pair_drive(table.device, [], [1.0, 1.0])
    picture = plot_factor(table, [["I"], ["II"], ["III"]], [], drive)
    assert len(picture.figure.axes) == 4  # with the colour bar
    shares = [picture.columns[f"localized factor {name} untouched (1)"] for name in ("I", "II", "III")]
    assert np.sum(shares, axis=0) == pytest.approx(1.0, abs=1e-5)
    together = plot_factor(table, [["I", "III"]], [], drive).columns["localized factor untouched (1)"]
    assert np.asarray(together) == pytest.approx(np.asarray(shares[0]) + np.asarray(shares[2]), abs=1e-6)


@pytest.mark.parametrize(
    ("names", "amplitudes", "part"),
    [
        (["left", "middle"], [1.0, 1.0], "left,right"),
        ([], [1.0, 0.55], "0, 0.2, 0.4, 0.6, 0.8, 1"),
        ([], [1.0], "'1'"),
        ([], [0.0, 0.0], "nothing moves"),
    ],
)
def test_a_drive_that_the_sweep_does_not_have_is_refused(
    table: Table, names: list[str], amplitudes: list[float], part: str
) -> None:
    with pytest.raises(TableError, match=part):
        pair_drive(table.device, names, amplitudes)


def test_every_picture_has_its_units_its_estimates_and_its_data(
    table: Table, state: tuple[ZoneState, ...], tmp_path: Path
) -> None:
    drive = entry_drive(table, table.entry_for(["I"], ["III"]))
    pictures = [plot_state(drive), plot_course(drive), plot_pareto(table, state), plot_contrast_map(table, 20.0)]
    pictures += [plot_rise(table, 20.0), plot_factor(table, [["I"]], ["I"], PairDrive((0, 1), (1.0, 1.0)))]
    words = {"drive", "felt zone", "quiet zone", "felt zones", "quiet zones", "family"}
    for picture in pictures:
        check_picture(picture, table.device, words, tmp_path)


@pytest.mark.parametrize(("ending", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".PDF", b"%PDF")])
def test_the_same_data_are_the_same_file(table: Table, ending: str, magic: bytes, tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}{ending}" for k in range(2)]
    for path in paths:
        write_picture(plot_contrast_map(table, 20.0), path)
    first, second = (path.read_bytes() for path in paths)
    assert first.startswith(magic)
    assert first == second


@pytest.mark.parametrize(
    ("picture", "data", "part"),
    [
        ("state.gif", None, ".png, .svg, .pdf"),
        ("state", None, ".png, .svg, .pdf"),
        ("state.png", "bar.nc", ".csv"),
        ("nowhere/state.png", None, "nowhere: no such folder"),
        ("state.png", "nowhere/state.csv", "nowhere: no such folder"),
    ],
)
def test_a_file_that_could_not_be_written_is_refused_before_work(picture: str, data: str | None, part: str) -> None:
    with pytest.raises(FigureError, match=part):
        check_paths(Path(picture), None if data is None else Path(data))


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
