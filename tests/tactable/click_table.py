"""A small table with clicks: three zones, few plants, one and two fingers at seven places; and a click from it."""

from math import inf
from pathlib import Path

from engine.device import Device
from engine.table import ClickEntry
from engine.table.clicks import played_at
from engine.touch import Placement
from precompute.builder.table_build import build_table
from precompute.clicks import ClickOptions
from tactable.explain.click_source import ClickSource
from tests.precompute.builder.test_table_build import SMALL

CHEAP = ClickOptions(pitch_m=46.6e-3, pool=90, judged=20)
FINGERS = 2


def build_click_table(folder: Path, clicks_up_to: int = FINGERS) -> Path:
    path = folder / "bar.nc"
    build_table(Device.parse(SMALL, "bar.toml"), path, created="", clicks_up_to=clicks_up_to, click_options=CHEAP)
    return path


def placed(source: ClickSource, felt: str, quiet: str = "") -> Placement:
    """Fingers in zones, such as "I II"."""
    return Placement.named(source.table.device, felt.split(), quiet.split())


def click_of(source: ClickSource, felt: str, quiet: str = "", level_db: float = inf) -> ClickEntry:
    return played_at(source.click_of(placed(source, felt, quiet)), level_db)
