"""Narrower zones: mirror laws, and the same figures as for the device itself."""

import numpy as np
import pytest

from base.points import parts_of
from precompute.model.assembly import assemble
from precompute.predict.untouched import greatest_factors
from precompute.studies.placement_search import (
    even_places,
    own_places,
    solve_two_fingers,
    study_resolution,
    with_equal_zones,
)
from tests.precompute.devices import coarsely_swept, shipped


@pytest.mark.parametrize(("count", "rows"), [(2, 1), (4, 2), (5, 1), (6, 2), (12, 3), (16, 4)])
def test_equal_zones_of_a_plate_cover_it_in_rows_that_make_them_most_nearly_square(count: int, rows: int) -> None:
    device = with_equal_zones(shipped("reference-p"), count)
    sides_m = {complex(*np.round(parts_of(zone.stop_m - zone.start_m), 12)) for zone in device.zones}
    assert sides_m == {complex(round(0.3 / (count // rows), 12), round(0.18 / rows, 12))}
    assert len({zone.middle_m for zone in device.zones}) == count
    assert device.zones[-1].stop_m == device.surface.corner_m
    assert with_equal_zones(device, 6).zones == shipped("reference-p").zones


def test_the_device_itself_has_its_own_figures() -> None:
    device = with_equal_zones(coarsely_swept(shipped("reference-d")), 3)
    (found,) = study_resolution(device, [own_places(device)], [3], 20.0, lambda _: None)
    assert found.fingers.worst_db == pytest.approx(solve_two_fingers(device, 20.0).worst_db, abs=1e-9)
    assert found.factor == pytest.approx(greatest_factors(assemble(device)), rel=1e-9)
    assert found.zone_width_m == pytest.approx(device.bar.length_m / 3)


def test_one_actuator_in_the_middle_cannot_tell_mirrored_fingers_apart() -> None:
    device, done = coarsely_swept(shipped("reference-a")), list[float]()
    two, three = study_resolution(device, [even_places(device, 1)], [2, 3], 20.0, done.append)
    assert two.fingers.worst_db == pytest.approx(0.0, abs=0.5)  # sampled fingers are no mirror images
    assert two.factor == pytest.approx([0.5, 0.5])
    mirrored = [three.fingers.contrast_db[i, 2 - i] for i in (0, 2)]
    assert mirrored == pytest.approx([0.0, 0.0], abs=0.5)
    assert done == [0.5, 1.0]
