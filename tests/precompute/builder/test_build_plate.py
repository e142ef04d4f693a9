"""Laws of the table of a plate: sweep, best rows, clicks and drives as of a bar, at points."""

from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.table import Table, TableError
from engine.touch.placement import Places
from precompute.builder.table_build import build_table
from precompute.clicks import ClickOptions
from precompute.model.assembly import assemble
from precompute.model.gram import compute_steady_state
from tactable.explain.words import model_text
from tests.precompute.devices import shipped

pytestmark = pytest.mark.long

CHEAP = ClickOptions(pitch_m=150e-3, pool=90, judged=20)
_CHANGES = {
    "rows = 2": "rows = 1",
    "columns = 3": "columns = 2",
    'step = "1 Hz"': 'step = "20 Hz"',
    "amplitude_steps = 5": "amplitude_steps = 2",
}


def small_plate() -> Device:
    text = shipped("reference-p").text
    for old, new in _CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    return Device.parse(text, "plate")


DEVICE = small_plate()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plate") / "plate.nc"
    build_table(DEVICE, path, created="", click_options=CHEAP)
    return path


def test_best_rows_are_what_the_plate_does_under_them(path: Path) -> None:
    plant = assemble(DEVICE)
    with Table.open(path, device=DEVICE) as table:
        for felt in (["I"], ["II"], ["I", "II"]):
            row = table.best_row(felt, 20.0)
            state = compute_steady_state(plant, np.array(row.frequencies_hz), row.complex_amplitudes)
            assert row.shares == pytest.approx(state.share, abs=1e-3)
            assert row.peaks_m_per_s2 == pytest.approx(state.peak, rel=3e-3)
            assert sum(row.shares) == pytest.approx(1.0, abs=1e-3)  # its zones cover the plate


def test_its_clicks_are_of_one_finger_at_points_and_lead_to_the_nearest(path: Path) -> None:
    with Table.open(path) as table:
        assert "functions" in model_text(table)
        assert table.places == Places(0.3 + 0.18j, 3, 3) and len(table.clicks) == 9
        found = table.click_for(["160 x 20 mm"], level_db=14.0)
        assert found.placement.position_m == (0.15 + 0j,) and found.level_db == pytest.approx(14.0)
        assert table.values("responses", "position_across").max() == pytest.approx(0.18)
        with pytest.raises(TableError, match=r"100 x 60 mm, 200 x 120 mm.*solved when they come"):
            table.click_for(["100 x 60 mm"], ["200 x 120 mm"])
