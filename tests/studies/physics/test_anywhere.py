"""Laws of the study of fingers anywhere: even placements, the solver's own figures, and positions beat zones."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from engine.table import Clicks
from engine.touch import PlacementError
from engine.touch.placement import Places
from precompute.clicks import ClickSolver
from precompute.clicks.tabulated import tabulate_clicks
from precompute.sampling.placements import Anywhere, random_placements
from tactable.shipped import find_device
from tests.precompute.clicks.click_cases import CHEAP
from tests.precompute.devices import shipped
from tests.studies.physics.against_peers import FEW, FOLDER, PUBLISHED
from tests.studies.physics.anywhere import changed, compare_anywhere, describe, draw

DEVICE, TABLET = shipped("reference-a"), shipped("reference-p")


@pytest.mark.parametrize("wanted", [Anywhere(), Anywhere(fingers=3, feeling=2), Anywhere(apart_m=0.04, is_exact=True)])
def test_placements_are_even_over_the_bar_and_keep_their_distance(wanted: Anywhere) -> None:
    wanted = replace(wanted, placements=2000)
    placements = random_placements(DEVICE, wanted)
    assert placements == random_placements(DEVICE, wanted) != random_placements(DEVICE, replace(wanted, seed=2))
    at_m = np.array([placement.position_m for placement in placements])
    gaps_m = np.diff(at_m, axis=1)
    assert (gaps_m == pytest.approx(wanted.apart_m)) if wanted.is_exact else (gaps_m >= wanted.apart_m - 1e-12).all()
    assert all(len(placement.felt) == wanted.feeling for placement in placements)
    assert at_m.min() < 0.01 and at_m.max() > DEVICE.bar.length_m - 0.01
    # Which finger feels, and at which end the fingers are, is a matter of chance.
    assert np.mean([placement.is_felt[0] for placement in placements]) == pytest.approx(
        wanted.feeling / wanted.fingers, abs=0.05
    )
    assert at_m.mean() == pytest.approx(DEVICE.bar.length_m / 2, rel=0.02)


@pytest.mark.parametrize("wanted", [Anywhere(), Anywhere(fingers=5), Anywhere(fingers=3, apart_m=0.04, is_exact=True)])
def test_placements_are_even_over_a_plate_both_ways(wanted: Anywhere) -> None:
    wanted, corner_m = replace(wanted, placements=2000), TABLET.surface.corner_m
    placements = random_placements(TABLET, wanted)
    assert placements == random_placements(TABLET, wanted) != random_placements(TABLET, replace(wanted, seed=2))
    at_m = np.array([placement.position_m for placement in placements])
    distance_m = abs(at_m[:, :, None] - at_m[:, None])[:, ~np.eye(wanted.fingers, dtype=bool)]
    assert distance_m.min() >= wanted.apart_m - 1e-8
    if wanted.is_exact:  # each from one of the others at least
        nearest_m = distance_m.reshape(len(at_m), wanted.fingers, -1).min(axis=2)
        assert nearest_m == pytest.approx(wanted.apart_m)
    for along_m, end_m in ((at_m.real, corner_m.real), (at_m.imag, corner_m.imag)):
        assert along_m.min() < 0.01 and along_m.max() > end_m - 0.01
        assert along_m.mean() == pytest.approx(end_m / 2, rel=0.03)
    felt = np.array([placement.is_felt for placement in placements])
    assert (felt.sum(axis=1) == wanted.feeling).all()
    assert felt.mean(axis=0) == pytest.approx(wanted.feeling / wanted.fingers, abs=0.05)


@pytest.mark.parametrize(
    "device, wanted, message",
    [
        (DEVICE, Anywhere(fingers=3, apart_m=0.15), "do not fit on 279.4 mm"),
        (DEVICE, Anywhere(feeling=3), "3 of 2 fingers feel"),
        (TABLET, Anywhere(fingers=3, apart_m=0.3), "do not fit on 300 x 180 mm"),
    ],
)
def test_what_no_surface_holds_is_refused(device: Device, wanted: Anywhere, message: str) -> None:
    with pytest.raises(PlacementError, match=message):
        random_placements(device, wanted)


def test_clicks_for_positions_are_the_solver_s_and_keep_quiet_where_those_for_zones_do_not() -> None:
    wanted = Anywhere(placements=6)
    result = compare_anywhere(DEVICE, wanted, 1, CHEAP, plants=20)
    placements = random_placements(DEVICE, wanted)
    assert [tuple(row["position_m"]) for row in result["placements"]] == [each.position_m for each in placements]
    own = ClickSolver(DEVICE, replace(CHEAP, tolerance_m=1e-3, judged=20)).solve(placements[3])
    row = result["placements"][3]["by_position"]
    assert own.quiet is not None
    assert (row["felt_db"]["low_db"], row["quiet_db"]["high_db"]) == (own.felt.low_db, own.quiet.high_db)
    here, zones = result["by_position"], result["by_zone"]
    assert here["placements"] == zones["placements"] == 6
    assert here["quiet_db"][2] < 3 < zones["quiet_db"][1]
    assert here["felt_db"] == pytest.approx(
        np.percentile([each["by_position"]["felt_db"]["low_db"] for each in result["placements"]], [5, 50, 95])
    )
    text = "\n".join(describe(DEVICE, wanted, result))
    assert all(word in text for word in ("Oh and Choi 2019", "each finger within 1 mm", "SIMULATED", "ESTIMATES"))
    assert len(draw(DEVICE, [0.025, 0.03], [result, result]).axes) == 2


@pytest.mark.long
def test_a_changed_plate_is_compared_in_brief() -> None:
    device, wanted = changed(TABLET, "plate.thickness=2 mm", 3), Anywhere(placements=1)
    assert device.surface.thickness_m == 2e-3 and len(device.actuators) == 3
    assert [each.position_m for each in device.actuators[::2]] == pytest.approx(
        [0.03 + 0.025j, 0.27 + 0.035j], abs=1e-4
    )
    result = compare_anywhere(device, wanted, 1, replace(CHEAP, pool=70), plants=10, is_brief=True)
    assert result["by_position"]["placements"] == 1 and not result["by_zone"]["placements"]
    assert result["by_position"]["felt_db"][1] > 10 > result["by_position"]["quiet_db"][1]
    assert len(describe(device, wanted, result)) >= 4


def test_a_table_s_clicks_and_the_drives_of_a_run_are_judged_at_the_same_fingers() -> None:
    places = Places.every(DEVICE.bar.length_m, 40e-3)
    wanted = Anywhere(placements=4, apart_m=0.06)
    keys = {places.key(placement) for placement in random_placements(DEVICE, wanted)}
    rows = list(tabulate_clicks(DEVICE, CHEAP, places, sorted(keys)))
    result = compare_anywhere(DEVICE, wanted, 1, CHEAP, Clicks.of(places, rows), plants=20)
    tabulated, own = (result[way] for way in ("by_table", "by_position"))
    assert tabulated["placements"] == own["placements"] == 4
    # Made for fingers within 21 mm of their places, a click cannot be as strong.
    assert tabulated["felt_db"][1] < own["felt_db"][1] - 3
    steady = result["steady"]
    assert steady["placements"] == 4 and 0 < steady["achieved"] <= 4
    contrasts_db = [row["steady"]["expected_contrast_db"] for row in result["placements"] if row["steady"]["achieved"]]
    assert steady["expected_contrast_db"] == pytest.approx(np.percentile(contrasts_db, [5, 50, 95]))
    text = "\n".join(describe(DEVICE, wanted, result))
    assert "of the table, for the nearest places" in text
    assert f"reaches 20 dB in {steady['achieved']} of 4" in text


def test_a_peer_s_plate_marks_all_but_what_was_published_as_estimates() -> None:
    assert sorted(f"{name}.toml" for name in PUBLISHED) == sorted(path.name for path in FOLDER.glob("*.toml"))
    published = {"plate.length", "plate.width", "plate.thickness"}
    for name, known in (("hudin-2015", published), ("pantera-2020", set[str]())):
        device = find_device(str(FOLDER / f"{name}.toml"))
        assert published - set(device.inferred) == known
        assert len(changed(device, "", FEW).actuators) == FEW < len(device.actuators)
